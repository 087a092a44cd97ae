//! Tables and counts for people.

use tabled::builder::Builder;
use tabled::settings::{Alignment, Style, object::Columns};

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
