//! Tables from CSV.

use super::{Cell, Table};

/// The table of a CSV file with a header, as [`columns_csv`](crate::columns_csv) writes it: lines
/// are grouped by their first field; empty first fields are omitted. `None` for other text.
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
        rows.push(fields.map(|field| Cell::from(shortened(field))).collect());
    }
    let header = header.iter().skip(1).map(String::from).collect();
    Some(Table { header, rows })
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
        let table = csv_table(text).expect("a table");
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
    fn other_text_is_no_table() {
        assert_eq!(csv_table("a,b\n1\n"), None);
        assert_eq!(csv_table("a\n1\n"), None);
        assert_eq!(csv_table("a,b\n").expect("empty").rows.len(), 0);
    }
}
