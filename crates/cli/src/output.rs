//! Lines, tables and counts for people.

use std::fmt;
use std::io::{self, ErrorKind, Write};

use tabled::builder::Builder;
use tabled::settings::{Alignment, Style, object::Columns};

/// Prints a line of results to standard output.
///
/// Unlike `println!`, it does not panic where nobody reads on, as in `kinegrad ... | head`.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::result(format_args!($($text)*)) };
}

/// Prints a line about what is going on to standard error, or drops it where that is full: no
/// training ends for it.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::remark(format_args!($($text)*)) };
}

/// See [`say!`]. Where a result is lost though somebody reads, the program ends with exit code 1.
pub fn result(text: fmt::Arguments<'_>) {
    if let Err(error) = writeln!(io::stdout(), "{text}")
        && error.kind() != ErrorKind::BrokenPipe
    {
        remark(format_args!(
            "error: standard output cannot be written: {error}"
        ));
        std::process::exit(1);
    }
}

/// See [`tell!`].
pub fn remark(text: fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// A plain table: the first row is the header, columns after the first are aligned right.
pub fn table(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut builder = Builder::default();
    for row in rows {
        builder.push_record(row);
    }
    let mut table = builder.build();
    table
        .with(Style::psql())
        .modify(Columns::new(1..), Alignment::right());
    table.to_string()
}

/// `16342361` as `16,342,361`.
pub fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::grouped;

    #[test]
    fn thousands_are_grouped() {
        let cases = [
            (0, "0"),
            (999, "999"),
            (1000, "1,000"),
            (16_342_361, "16,342,361"),
        ];
        for (n, text) in cases {
            assert_eq!(grouped(n), text);
        }
    }
}
