//! TOML tables: merging, deserialization and overrides. Errors name file, line, key, the value
//! found and the allowed values.

use kinegrad_settings::{DocumentError, Place};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::{COMMON, Config, ConfigError, MODEL_KEYS, alternative};

/// Merges the values of `above` into `table`, table by table.
pub fn lay_over(table: &mut Table, above: Table) {
    for (key, value) in above {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => lay_over(below, above),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// The value of a dotted key, or of an element of a list: `lora.targets[1]`.
pub(crate) fn value_at<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    if let Some((name, rest)) = key.split_once('.') {
        return value_at(table.get(name)?.as_table()?, rest);
    }
    match key.split_once('[') {
        Some((name, index)) => {
            let index: usize = index.strip_suffix(']')?.parse().ok()?;
            table.get(name)?.as_array()?.get(index)
        }
        None => table.get(key),
    }
}

/// The config as TOML text with every key.
pub fn to_toml(config: &Config) -> String {
    toml::to_string(config).expect("a config is a table of plain values")
}

/// Deserializes `table`; `place` locates a dotted key. All configs share this deserializer, because
/// each deserializer adds much code to this crate.
pub(crate) fn from_table<T: DeserializeOwned>(
    table: &Table,
    place: Place<'_>,
) -> Result<T, ConfigError> {
    let names: Vec<&str> = table.keys().map(String::as_str).collect();
    log::trace!(
        "parsing {}: {}",
        std::any::type_name::<T>(),
        names.join(", ")
    );
    // Keys of the same table that another type reads.
    let beside: [(&str, &[&str]); 2] = [("", &COMMON), ("model", &MODEL_KEYS)];
    let help = "`kinegrad config explain` lists every key";
    Ok(kinegrad_settings::from_table(table, place, help, &beside)?)
}

/// Sets one dotted key and removes its alternative. A value that is not TOML is taken as text, so that
/// `run.device=cpu` needs no quotes in a shell.
pub(crate) fn apply(table: &mut Table, argument: &str) -> Result<(), ConfigError> {
    let wrong = || ConfigError::Override {
        argument: argument.to_string(),
    };
    let (key, text) = argument.split_once('=').ok_or_else(wrong)?;
    let segments: Vec<&str> = key.trim().split('.').map(str::trim).collect();
    if segments.iter().any(|segment| segment.is_empty()) {
        return Err(wrong());
    }
    let value = format!("value = {text}")
        .parse::<Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| Value::String(text.trim().to_string()));
    let (last, parents) = segments
        .split_last()
        .expect("split yields at least one segment");
    let mut current = table;
    for parent in parents {
        let entry = current
            .entry(parent.to_string())
            .or_insert_with(|| Value::Table(Table::new()));
        current = entry.as_table_mut().ok_or_else(|| DocumentError::Value {
            place: format!("option `set {argument}`"),
            key: key.to_string(),
            message: format!("`{parent}` is a value, not a table"),
            hint: "keys are written table.key".into(),
        })?;
    }
    current.insert(last.to_string(), value);
    if let Some(other) = alternative(&segments.join(".")) {
        let (_, name) = other.rsplit_once('.').expect("a dotted key");
        current.remove(name);
    }
    Ok(())
}
