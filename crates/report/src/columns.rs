//! Columns of named values side by side.

use std::borrow::Cow;

use kinegrad_output::is_formula;

use crate::table::rows_within;

/// Placeholder of a missing value in tables.
const MISSING: &str = "-";

/// A section: heading and named values; `None` for values that do not apply.
pub type Section<'a> = (&'a str, Vec<(&'a str, Option<String>)>);

/// A column of values, such as those of a run.
pub struct Column<'a> {
    /// Its label.
    pub label: String,
    /// The same sections in every column; names may differ.
    pub sections: Vec<Section<'a>>,
}

/// A line across all columns: index and heading of the section, name, values.
struct Line<'a> {
    section: usize,
    heading: &'a str,
    name: &'a str,
    values: Vec<Option<&'a str>>,
}

/// All columns as a table with one line per value, in at most `width` characters.
pub fn columns_table(columns: &[Column<'_>], width: Option<usize>) -> String {
    let mut all = vec![vec![String::new()]];
    all[0].extend(columns.iter().map(|column| column.label.clone()));
    let mut section = None;
    for line in lines(columns) {
        if section.replace(line.section) != Some(line.section) && !line.heading.is_empty() {
            let mut heading = vec![line.heading.to_string()];
            heading.resize(columns.len() + 1, String::new());
            all.push(heading);
        }
        let cells = line.values.iter().map(|value| value.unwrap_or(MISSING));
        let cells = [line.name].into_iter().chain(cells);
        all.push(cells.map(String::from).collect());
    }
    rows_within(all, width)
}

/// All columns as CSV with one line per value: section heading and name under `heads`, then the
/// values. A missing value is an empty field.
pub fn columns_csv(heads: [&str; 2], columns: &[Column<'_>]) -> String {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let mut write = |fields: &mut dyn Iterator<Item = &str>| {
        let written = csv.write_record(fields.map(|field| plain(field).into_owned()));
        written.expect("written to memory");
    };
    let labels = columns.iter().map(|column| column.label.as_str());
    write(&mut heads.into_iter().chain(labels));
    for line in lines(columns) {
        let fields = line.values.iter().map(|value| value.unwrap_or_default());
        write(&mut [line.heading, line.name].into_iter().chain(fields));
    }
    let bytes = csv.into_inner().expect("written to memory");
    String::from_utf8(bytes).expect("text")
}

/// The field with an apostrophe before text that a spreadsheet would read as a formula.
fn plain(field: &str) -> Cow<'_, str> {
    match is_formula(field) {
        true => Cow::Owned(format!("'{field}")),
        false => Cow::Borrowed(field),
    }
}

/// The lines of all sections; each name occurs once, in order of first appearance.
fn lines<'a>(columns: &'a [Column<'a>]) -> Vec<Line<'a>> {
    let mut lines = Vec::new();
    let sections = columns.first().map_or(0, |column| column.sections.len());
    for section in 0..sections {
        let first = lines.len();
        for (place, column) in columns.iter().enumerate() {
            let (heading, values) = &column.sections[section];
            for (name, value) in values {
                let mut known = lines[first..].iter();
                let known = known.position(|line: &Line<'_>| line.name == *name);
                let index = known.map_or(lines.len(), |known| first + known);
                if known.is_none() {
                    lines.push(Line {
                        section,
                        heading,
                        name,
                        values: vec![None; columns.len()],
                    });
                }
                lines[index].values[place] = value.as_deref();
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> [Column<'static>; 2] {
        let value = |name, value: &str| (name, Some(value.to_string()));
        let sections = |counts, numbers| vec![("", counts), ("RAW", numbers)];
        [
            Column {
                label: "one".into(),
                sections: sections(vec![value("step", "7")], vec![value("b", "1"), ("a", None)]),
            },
            Column {
                label: "real".into(),
                sections: sections(vec![("step", None)], vec![value("b", "3"), value("c", "4")]),
            },
        ]
    }

    #[test]
    fn names_keep_their_first_place_and_missing_values_are_marked() {
        let shown = columns_table(&columns(), None);
        let lines: Vec<&str> = shown.lines().map(str::trim_end).collect();
        assert_eq!(
            lines,
            [
                "      | one | real",
                "------+-----+------",
                " step |   7 |    -",
                " RAW  |     |",
                " b    |   1 |    3",
                " a    |   - |    -",
                " c    |   - |    4",
            ]
        );
    }

    #[test]
    fn csv_names_the_section_of_each_line() {
        assert_eq!(
            columns_csv(["samples", "measure"], &columns()),
            "samples,measure,one,real\n,step,7,\nRAW,b,1,3\nRAW,a,,\nRAW,c,,4\n"
        );
    }

    #[test]
    fn names_are_no_formulas_in_csv() {
        let mut columns = columns();
        columns[0].label = "=cmd|'/C calc'!A0".into();
        columns[1].sections[0].1[0] = ("@step", Some("-1.5e-3".into()));
        columns[1].sections[1].1[0] = ("b", Some("+b".into()));
        let csv = columns_csv(["samples", "measure"], &columns);
        assert_eq!(
            csv,
            "samples,measure,'=cmd|'/C calc'!A0,real\n,step,7,\n,'@step,,-1.5e-3\nRAW,b,1,'+b\nRAW,a,,\n\
             RAW,c,,4\n"
        );
    }
}
