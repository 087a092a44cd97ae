//! Tables from CSV.

use super::{Cell, Table};

/// The table of a CSV file with a header, as [`columns_csv`](crate::columns_csv) writes it: lines
/// are grouped by their first field; empty first fields are omitted. Numbers are in full. `None` for
/// other text.
pub fn csv_table(text: &str) -> Option<Table> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().ok()?.clone();
    if header.len() < 2 {
        return None;
    }
    let mut rows = Vec::new();
    let mut group = String::new();
    for record in reader.records() {
        let record = record.ok()?;
        let first = record.get(0)?;
        if first != group {
            group = first.to_string();
            rows.push(vec![Cell::from(first)]);
        }
        let fields = record.iter().skip(1);
        rows.push(fields.map(Cell::from).collect());
    }
    let header = header.iter().skip(1).map(String::from).collect();
    Some(Table { header, rows })
}

impl Table {
    /// The columns of all tables side by side, except their first ones: those are the names of the
    /// rows. A row of the same heading and name in several tables is one row. Rows and headings keep
    /// the order in which they first appear.
    #[must_use]
    pub fn side_by_side(tables: &[Self]) -> Self {
        let mut header: Vec<String> = Vec::new();
        // The rows without a heading, then headings with their rows; a row begins with its name.
        let mut groups = vec![vec![vec![Cell::default()]]];
        for table in tables {
            let before = header.len().max(1);
            let skipped = usize::from(!header.is_empty());
            header.extend(table.header.iter().skip(skipped).cloned());
            let mut own = 0;
            for row in &table.rows {
                let [name, cells @ ..] = &row[..] else {
                    continue;
                };
                if cells.is_empty() {
                    own = place(
                        &mut groups,
                        |group| group[0][0] == *name,
                        || vec![row.clone()],
                    );
                    continue;
                }
                let known = |known: &Vec<Cell>| known.len() > 1 && known[0] == *name;
                let at = place(&mut groups[own], known, || vec![name.clone()]);
                let joined = &mut groups[own][at];
                joined.resize(before, Cell::default());
                joined.extend_from_slice(cells);
            }
        }
        let mut rows: Vec<Vec<Cell>> = groups.into_iter().flatten().skip(1).collect();
        for row in rows.iter_mut().filter(|row| row.len() > 1) {
            row.resize(header.len(), Cell::default());
        }
        Self { header, rows }
    }

    /// With about four digits of each number after the first column.
    pub fn shorten(&mut self) {
        let rows = self.rows.iter_mut();
        for cell in rows.flat_map(|row| row.iter_mut().skip(1)) {
            cell.text = shortened(&cell.text);
        }
    }
}

/// The place of the element that `is` the wanted one, or of the `new` last one.
fn place<T>(all: &mut Vec<T>, is: impl Fn(&T) -> bool, new: impl FnOnce() -> T) -> usize {
    all.iter().position(is).unwrap_or_else(|| {
        all.push(new());
        all.len() - 1
    })
}

/// Numbers with about four digits, other text unchanged.
fn shortened(field: &str) -> String {
    let Ok(number) = field.parse::<f64>() else {
        return field.to_string();
    };
    match number.abs() {
        _ if number.fract() == 0.0 || !number.is_finite() => field.to_string(),
        size if !(1e-3..1e6).contains(&size) => format!("{number:.3e}"),
        size if size >= 100.0 => format!("{number:.1}"),
        size if size >= 1.0 => format!("{number:.3}"),
        _ => format!("{number:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_stand_below_the_name_of_their_group() {
        let text = "samples,measure,one,real\n,step,7,\nRAW,b,1.23456,3\nRAW,c,,0.00001\n";
        let mut table = csv_table(text).expect("a table");
        table.shorten();
        assert_eq!(table.header, ["measure", "one", "real"]);
        let rows = [
            vec!["step", "7", ""],
            vec!["RAW"],
            vec!["b", "1.235", "3"],
            vec!["c", "", "1.000e-5"],
        ];
        let rows = rows.map(|row| row.into_iter().map(Cell::from).collect::<Vec<_>>());
        assert_eq!(table.rows, rows);
    }

    #[test]
    fn tables_side_by_side_have_common_rows() {
        let texts = [
            "samples,measure,one\n,step,7\nRAW,b,1\nRAW,c,2\n",
            "samples,measure,two,real\n,step,8,\nOWN,b,5,6\nRAW,c,3,4\n",
        ];
        let tables = texts.map(|text| csv_table(text).expect("a table"));
        let both = Table::side_by_side(&tables);
        assert_eq!(both.header, ["measure", "one", "two", "real"]);
        let rows = [
            vec!["step", "7", "8", ""],
            vec!["RAW"],
            vec!["b", "1", "", ""],
            vec!["c", "2", "3", "4"],
            vec!["OWN"],
            vec!["b", "", "5", "6"],
        ];
        let rows = rows.map(|row| row.into_iter().map(Cell::from).collect::<Vec<_>>());
        assert_eq!(both.rows, rows);
        assert_eq!(Table::side_by_side(&tables[..1]), tables[0]);
    }

    #[test]
    fn other_text_is_no_table() {
        assert_eq!(csv_table("a,b\n1\n"), None);
        assert_eq!(csv_table("a\n1\n"), None);
        assert_eq!(csv_table("a,b\n").expect("empty").rows.len(), 0);
    }
}
