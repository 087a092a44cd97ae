//! Tables and numbers.

use tabled::builder::Builder;
use tabled::settings::{Alignment, Style, object::Columns};

/// A plain table with a header as the first row; columns after the first are right-aligned.
pub fn rows<R>(rows: impl IntoIterator<Item = R>) -> String
where
    R: IntoIterator,
    R::Item: Into<String>,
{
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

/// [`rows`] below a header.
pub fn table<const N: usize>(
    header: [&str; N],
    body: impl IntoIterator<Item = [String; N]>,
) -> String {
    rows(std::iter::once(header.map(String::from)).chain(body))
}

/// [`rows`] of names and values.
pub fn facts<'a>(facts: impl IntoIterator<Item = (&'a str, String)>) -> String {
    let facts = facts.into_iter();
    rows(facts.map(|(name, value)| [name.to_string(), value]))
}

/// `16342361` as `16,342,361`.
pub fn grouped(n: usize) -> String {
    let mut digits = n.to_string();
    let places = (1..digits.len()).rev().skip(2).step_by(3);
    places.for_each(|place| digits.insert(place, ','));
    digits
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn numbers_stand_on_the_right_below_their_header() {
        let cells = ["a check".to_string(), "1".to_string()];
        let shown = table(["name", "value"], [cells]);
        let lines: Vec<&str> = shown.lines().map(str::trim_end).collect();
        assert_eq!(
            lines,
            [" name    | value", "---------+-------", " a check |     1"]
        );
    }
}
