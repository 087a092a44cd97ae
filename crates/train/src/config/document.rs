//! Tables of TOML: laid over each other, read into settings, changed key by key, with errors that
//! name file, line, key, what was found and what is allowed.

use kinegrad_settings::{Unfit, in_words};
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{COMMON, Config, ConfigError, MODEL_KEYS, PLAIN};

/// Says where a dotted key stands, such as `FILE:LINE`.
pub type Place<'a> = &'a dyn Fn(&str) -> String;

/// The error of a value that is none of the `names` that `key` may have.
pub(crate) fn not_among(place: String, key: &str, found: &str, names: &[&str]) -> ConfigError {
    let bare = found.trim_matches('"');
    ConfigError::Value {
        place,
        key: key.into(),
        message: format!("{found} is not among {}", names.join(", ")),
        hint: match nearest(bare, names) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("choose one of: {}", names.join(", ")),
        },
    }
}

/// Puts the values of `above` into `table`, table by table.
pub(crate) fn lay_over(table: &mut Table, above: Table) {
    for (key, value) in above {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => lay_over(below, above),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// The config as TOML text, every key written out.
pub fn to_toml(config: &Config) -> String {
    toml::to_string(config).expect("a config is a table of plain values")
}

/// Deserialises `table`; `place` says where a dotted key stands. Every config comes through here
/// and no other deserialiser: the code of one is a large part of this crate.
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
    serde_path_to_error::deserialize(Value::Table(table.clone()))
        .map_err(|error| explain(place, &error.path().to_string(), error.inner().message()))
}

/// Rejects numbers that are not finite: no setting means one, and saved configs cannot hold one.
///
/// # Errors
/// Names the first such key.
pub(crate) fn must_be_finite(table: &Table, place: Place<'_>) -> Result<(), ConfigError> {
    let hint = "write a number, or leave the key out for its default";
    kinegrad_settings::must_be_finite(table).map_err(|unfit| unfit_at(place, unfit, hint))
}

/// Rejects lists where `config`, which `given` was read as, has tables.
///
/// # Errors
/// Names the first such key.
pub(crate) fn must_be_tables(
    given: &Table,
    config: &Config,
    place: Place<'_>,
) -> Result<(), ConfigError> {
    let read = Table::try_from(config).expect(PLAIN);
    let tables = kinegrad_settings::must_be_tables(given, &read);
    tables.map_err(|unfit| {
        unfit_at(
            place,
            unfit,
            "name each value: `[table]`, then `key = value`",
        )
    })
}

fn unfit_at(place: Place<'_>, unfit: Unfit, hint: &str) -> ConfigError {
    ConfigError::Value {
        place: place(&unfit.key),
        key: unfit.key,
        message: unfit.problem,
        hint: hint.into(),
    }
}

/// Sets one dotted key; a value that is not TOML is taken as text, so that `run.device=cpu` needs
/// no quotes in a shell.
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
        current = entry.as_table_mut().ok_or_else(|| ConfigError::Value {
            place: format!("option `set {argument}`"),
            key: key.to_string(),
            message: format!("`{parent}` is a value, not a table"),
            hint: "keys are written table.key".into(),
        })?;
    }
    current.insert(last.to_string(), value);
    Ok(())
}

pub(crate) fn place(origin: &str, line: Option<usize>) -> String {
    match line {
        Some(line) => format!("{origin}:{line}"),
        None => origin.to_string(),
    }
}

/// The hint that fits every key.
const SHOW: &str = "`kinegrad config explain` lists every key";

/// The line of a byte, counted from 1.
pub(crate) fn line_of(text: &str, byte: usize) -> usize {
    text[..byte.min(text.len())].matches('\n').count() + 1
}

/// Where `path`, such as `model.channel_mult[2]`, stands in the text that `table` was parsed from,
/// or the nearest key above it.
pub(crate) fn start_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
    let beginnings = table.iter().filter_map(|(name, value)| {
        let rest = path.strip_prefix(name.get_ref().as_ref())?;
        let ends = rest.is_empty() || rest.starts_with(['.', '[']);
        ends.then_some((name, value, rest))
    });
    // A key in quotes may hold a dot: the longest is meant.
    let (name, value, rest) = beginnings.min_by_key(|(_, _, rest)| rest.len())?;
    let inner = match value.get_ref() {
        DeValue::Table(inner) => rest
            .strip_prefix('.')
            .and_then(|rest| start_of(inner, rest)),
        DeValue::Array(elements) => {
            let index = rest
                .strip_prefix('[')
                .and_then(|rest| rest.split(']').next());
            let element = index.and_then(|index| elements.get(index.parse::<usize>().ok()?));
            element.map(|element| element.span().start)
        }
        _ => None,
    };
    inner.or(Some(name.span().start))
}

/// Turns serde's words for an unknown key or name into an error with the nearest valid one.
fn explain(place: Place<'_>, path: &str, message: &str) -> ConfigError {
    let message = message.trim().lines().next().unwrap_or_default();
    let mut quoted = message.split('`').skip(1).step_by(2);
    if message.starts_with("unknown field") {
        let found = quoted.next().unwrap_or_default();
        let parent = match path {
            "." => "",
            path => path.strip_suffix(found).unwrap_or(path),
        };
        let parent = parent.trim_end_matches('.');
        let join = |key: &str| match parent {
            "" => key.to_string(),
            parent => format!("{parent}.{key}"),
        };
        // Keys of the same table that are read by another type.
        let beside: &[&str] = match parent {
            "" => &COMMON,
            "model" => &MODEL_KEYS,
            _ => &[],
        };
        let allowed: Vec<&str> = beside.iter().copied().chain(quoted).collect();
        let hint = match nearest(found, &allowed) {
            Some(near) => format!("did you mean `{}`?", join(near)),
            None => SHOW.into(),
        };
        let key = join(found);
        return ConfigError::UnknownKey {
            place: place(&key),
            key,
            allowed: allowed.join(", "),
            hint,
        };
    }
    if message.starts_with("unknown variant") {
        let found = quoted.next().unwrap_or_default();
        let names: Vec<&str> = quoted.collect();
        return not_among(place(path), path, &format!("\"{found}\""), &names);
    }
    ConfigError::Value {
        place: place(path),
        key: path.to_string(),
        message: in_words(message),
        hint: SHOW.into(),
    }
}

/// The one of `allowed` that is most like `found`, if one is like it.
pub(crate) fn nearest<'a>(found: &str, allowed: &[&'a str]) -> Option<&'a str> {
    let similar = |name: &&'a str| (strsim::jaro_winkler(found, name), *name);
    let near = allowed.iter().map(similar).filter(|near| near.0 > 0.75);
    near.max_by(|a, b| a.0.total_cmp(&b.0)).map(|near| near.1)
}
