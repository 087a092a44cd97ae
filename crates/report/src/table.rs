//! Tables and numbers.

use kinegrad_output::cell;
use tabled::builder::Builder;
use tabled::settings::object::Columns;
use tabled::settings::{Alignment, Padding, Style, Width};

/// Narrowest column of names that text is wrapped to.
const NARROWEST: usize = 16;

/// A plain table with a header as the first row; columns after the first are right-aligned.
pub fn rows<R>(rows: impl IntoIterator<Item = R>) -> String
where
    R: IntoIterator,
    R::Item: Into<String>,
{
    plain(rows, None)
}

/// [`rows`] of one length, in at most `width` characters: text of the first column is wrapped. If
/// that is not enough, columns that do not fit follow below as further tables, each with the first
/// column.
pub fn rows_within(all: Vec<Vec<String>>, width: Option<usize>) -> String {
    let table = rows(&all);
    let Some(width) = width.filter(|width| *width < widest(&table)) else {
        return table;
    };
    let count = all.first().map_or(0, Vec::len);
    let names = all.iter().map(|row| row[0].chars().count()).max();
    // Width of the first column in a table of some columns.
    let names = |columns: &[usize]| {
        let excess = widest(&rows(part(&all, columns))).saturating_sub(width);
        names.unwrap_or(0).saturating_sub(excess)
    };
    let fits = |columns: &[usize]| names(columns) >= NARROWEST;
    let mut parts: Vec<Vec<usize>> = Vec::new();
    for column in 1..count {
        match parts.last_mut() {
            Some(last) if fits(&[last.as_slice(), &[column]].concat()) => last.push(column),
            _ => parts.push(vec![column]),
        }
    }
    let tables = parts.iter().map(|columns| {
        let names = names(columns).max(NARROWEST);
        plain(part(&all, columns), Some(names))
    });
    tables.collect::<Vec<_>>().join("\n\n")
}

/// The first column and some others.
fn part<'a>(all: &'a [Vec<String>], columns: &[usize]) -> Vec<Vec<&'a str>> {
    let row = |row: &'a Vec<String>| {
        let places = [0].iter().chain(columns);
        places.map(|&place| row[place].as_str()).collect()
    };
    all.iter().map(row).collect()
}

/// Text with line breaks between words, for lines of at most `width` characters.
pub fn wrapped(text: &str, width: Option<usize>) -> String {
    let text = &*cell(text);
    let Some(width) = width.filter(|width| *width < widest(text)) else {
        return text.to_owned();
    };
    let mut builder = Builder::default();
    builder.push_record([text]);
    let mut table = builder.build();
    let wrap = Width::wrap(width).keep_words(true);
    table.with((Style::empty(), Padding::zero(), wrap));
    let lines = table.to_string();
    let lines: Vec<&str> = lines.lines().map(str::trim_end).collect();
    lines.join("\n")
}

fn widest(text: &str) -> usize {
    let lines = text.lines().map(|line| line.trim_end().chars().count());
    lines.max().unwrap_or(0)
}

/// The table, with text of the first column wrapped to `names` characters.
fn plain<R>(rows: impl IntoIterator<Item = R>, names: Option<usize>) -> String
where
    R: IntoIterator,
    R::Item: Into<String>,
{
    let mut builder = Builder::default();
    for row in rows {
        let cells = row.into_iter().map(Into::into);
        builder.push_record(cells.map(|text: String| cell(&text).into_owned()));
    }
    let mut table = builder.build();
    table
        .with(Style::psql())
        .modify(Columns::new(1..), Alignment::right());
    if let Some(names) = names {
        table.modify(Columns::first(), Width::wrap(names).keep_words(true));
    }
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
    fn tables_and_text_fit_the_width() {
        let title = "movement: mean jerk of the path, m/s^3";
        let cell = |text: &str| text.to_string();
        let rows = vec![
            ["", "one", "two", "real"].map(cell).to_vec(),
            [title, "80.123 (1.000 to 90.000)", "7.100", "5.2"]
                .map(cell)
                .to_vec(),
            ["diversity", "1.2", "1.3", "1.4"].map(cell).to_vec(),
        ];
        let whole = rows_within(rows.clone(), None);
        assert_eq!(whole, super::rows(&rows));
        assert_eq!(rows_within(rows.clone(), Some(200)), whole);
        for (width, tables) in [(48, 2), (60, 1), (70, 1)] {
            let found = rows_within(rows.clone(), Some(width));
            assert!(widest(&found) <= width, "{width}:\n{found}");
            assert_eq!(found.matches("diversity").count(), tables, "{found}");
            for text in ["80.123 (1.000 to 90.000)", "7.100", "5.2"] {
                assert_eq!(found.matches(text).count(), 1, "{found}");
            }
        }
        let said = wrapped("one two three four", Some(9));
        assert_eq!(said, "one two\nthree\nfour");
        assert_eq!(wrapped("one two three four", None), "one two three four");
    }

    #[test]
    fn a_cell_cannot_begin_a_line() {
        let cells = ["a\nerror: \u{1b}[2J".to_string(), "1".to_string()];
        let shown = table(["name", "value"], [cells]);
        assert!(
            shown.trim_end().ends_with(" a\\nerror: \\u{1b}[2J |     1"),
            "{shown}"
        );
    }

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
