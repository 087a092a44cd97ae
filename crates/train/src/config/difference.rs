//! Comparing the config of a resumed run with the saved one.

use serde::Serialize;
use serde_json::Value;

/// A key with two values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Difference {
    /// Dotted key.
    pub key: String,
    /// Value on the left side, as JSON, or `unset`.
    pub left: String,
    /// Value on the right side.
    pub right: String,
}

/// The keys whose values differ, in the order of the tables.
pub(crate) fn difference<T: Serialize>(left: &T, right: &T) -> Vec<Difference> {
    let value = |side: &T| serde_json::to_value(side).expect(super::PLAIN);
    let mut found = Vec::new();
    compare(String::new(), &value(left), &value(right), &mut found);
    found
}

fn compare(key: String, left: &Value, right: &Value, found: &mut Vec<Difference>) {
    if let (Value::Object(left), Value::Object(right)) = (left, right) {
        let mut names: Vec<&String> = left.keys().chain(right.keys()).collect();
        names.sort_unstable();
        names.dedup();
        for name in names {
            let child = match key.is_empty() {
                true => name.clone(),
                false => format!("{key}.{name}"),
            };
            let side = |table: &serde_json::Map<String, Value>| {
                table.get(name).cloned().unwrap_or(Value::Null)
            };
            compare(child, &side(left), &side(right), found);
        }
    } else if left != right {
        let [left, right] = [left, right].map(|value| match value {
            Value::Null => "unset".to_string(),
            value => value.to_string(),
        });
        found.push(Difference { key, left, right });
    }
}
