//! What serde accepts in a TOML document though no setting means it.

use thiserror::Error;
use toml::{Table, Value};

/// A value that nothing can be made of.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("`{key}`: {problem}")]
pub struct Unfit {
    /// The dotted key, elements of lists counted from 0.
    pub key: String,
    /// What was found and what is allowed.
    pub problem: String,
}

/// Rejects numbers that are not finite: no setting means one, and JSON cannot hold one.
///
/// # Errors
/// Names the first such key.
pub fn must_be_finite(given: &Table) -> Result<(), Unfit> {
    let found = given
        .iter()
        .find_map(|(key, value)| not_finite(key.clone(), value));
    match found {
        None => Ok(()),
        Some((key, number)) => Err(Unfit {
            key,
            problem: format!("{number} is not a finite number"),
        }),
    }
}

/// The first number in `value`, which stands at `key`, that is not finite, and its key.
fn not_finite(key: String, value: &Value) -> Option<(String, f64)> {
    match value {
        Value::Float(number) => (!number.is_finite()).then_some((key, *number)),
        Value::Array(values) => {
            let mut values = values.iter().enumerate();
            values.find_map(|(index, value)| not_finite(format!("{key}[{index}]"), value))
        }
        Value::Table(table) => {
            let mut entries = table.iter();
            entries.find_map(|(name, value)| not_finite(format!("{key}.{name}"), value))
        }
        _ => None,
    }
}

/// Rejects lists in the place of tables, which serde reads by the order of a table's fields. `read`
/// is what `given` was read as, written again.
///
/// # Errors
/// Names the first such key.
pub fn must_be_tables(given: &Table, read: &Table) -> Result<(), Unfit> {
    match list_for_table("", given, read) {
        None => Ok(()),
        Some((key, elements)) => Err(Unfit {
            key,
            problem: format!(
                "a list of {elements} values, allowed: a table of `name = value` entries"
            ),
        }),
    }
}

/// Key and length of the first list in `given`, whose keys begin with `prefix`, where `read` has a
/// table.
fn list_for_table(prefix: &str, given: &Table, read: &Table) -> Option<(String, usize)> {
    given.iter().find_map(|(name, value)| {
        let key = format!("{prefix}{name}");
        list_at(key, value, read.get(name)?)
    })
}

/// [`list_for_table`] of one value.
fn list_at(key: String, given: &Value, read: &Value) -> Option<(String, usize)> {
    match (given, read) {
        (Value::Array(given), Value::Table(_)) => Some((key, given.len())),
        (Value::Array(given), Value::Array(read)) => {
            let mut both = given.iter().zip(read).enumerate();
            both.find_map(|(index, (given, read))| list_at(format!("{key}[{index}]"), given, read))
        }
        (Value::Table(given), Value::Table(read)) => {
            list_for_table(&format!("{key}."), given, read)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Table {
        text.parse().unwrap()
    }

    #[test]
    fn numbers_that_are_not_finite_are_named_wherever_they_stand() {
        for (text, key) in [
            ("a = inf", "a"),
            ("a.b = [1.0, nan]", "a.b[1]"),
            ("[[a]]\nb = 1\n[[a]]\nb = -inf", "a[1].b"),
        ] {
            let unfit = must_be_finite(&table(text)).unwrap_err();
            assert_eq!(unfit.key, key);
            assert!(unfit.to_string().contains("is not a finite number"));
        }
        must_be_finite(&table("a = 1e300\nb = [\"nan\"]")).unwrap();
    }

    #[test]
    fn lists_in_the_place_of_tables_are_named_wherever_they_stand() {
        let read = table("a.b.c = 1\nd = [[1, 2], [3, 4]]\ne = [{ f = 1 }, { f = 2 }]");
        for (text, key) in [
            ("a = [[1]]", "a"),
            ("a = []", "a"),
            ("a.b = [1]", "a.b"),
            ("e = [{ f = 1 }, [2]]", "e[1]"),
        ] {
            assert_eq!(must_be_tables(&table(text), &read).unwrap_err().key, key);
        }
        must_be_tables(&read, &read).unwrap();
        must_be_tables(&table("of_old_versions = [1]"), &read).unwrap();
    }
}
