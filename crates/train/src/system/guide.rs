//! Hints for config errors.

use kinegrad_settings::{DocumentError, Values, not_among};
use toml::{Table, Value};

use super::Systems;
use crate::config::{ConfigError, TrainConfig, value_at};

impl Systems<'_> {
    /// Adds a hint about the key to `error` of the config `given`.
    pub(super) fn guided(self, error: ConfigError, given: &Table) -> ConfigError {
        let named = given.get("train").and_then(|train| train.get("recipe"));
        let default = TrainConfig::default().recipe;
        let recipe = named.and_then(Value::as_str).unwrap_or(&default);
        let ConfigError::Document(mut error) = error else {
            return error;
        };
        match &mut error {
            DocumentError::UnknownKey { key, hint, .. } => {
                *hint = self.suggestion(key, recipe).unwrap_or(hint.clone());
            }
            DocumentError::Value {
                place,
                key,
                message,
                hint,
            } if message.starts_with("expected") => {
                let mut described = self.described();
                described.retain(|(known, recipes)| {
                    let below = key.strip_prefix(&known.name);
                    recipes.contains(&recipe)
                        && below
                            .is_some_and(|below| below.is_empty() || below.starts_with(['.', '[']))
                });
                let described = described.iter();
                if let Some((known, _)) = described.max_by_key(|(known, _)| known.name.len()) {
                    // The element of a list takes a name, the list itself does not.
                    let is_name = matches!(known.values, Values::Names(_)) || key.ends_with(']');
                    let names = known.values.names().iter();
                    let names: Vec<&str> = names.map(|name| name.name.as_str()).collect();
                    match value_at(given, key) {
                        Some(found) if is_name && !names.is_empty() => {
                            error = not_among(place.clone(), key, &found.to_string(), &names);
                        }
                        _ => {
                            *hint =
                                format!("`kinegrad config explain {}` describes it", known.name);
                        }
                    }
                }
            }
            _ => {}
        }
        error.into()
    }

    /// A suggestion for the unknown `key` in a config of `recipe`.
    pub(super) fn suggestion(self, key: &str, recipe: &str) -> Option<String> {
        let last = last(key);
        let mut described = self.described();
        described.retain(|(known, _)| !known.name.contains("[]"));
        if let Some((known, recipes)) = described.iter().find(|(known, _)| known.name == key) {
            return match (&known.only_with, recipes.contains(&recipe)) {
                (Some(with), true) => Some(format!("it is a key of `{with}`")),
                (None, true) => None,
                (_, false) => Some(format!(
                    "it is a key of recipe {}; `train.recipe` is \"{recipe}\"",
                    recipes.join(", ")
                )),
            };
        }
        let mut same: Vec<String> = described
            .iter()
            .filter(|(known, recipes)| known.name.ends_with(last) && recipes.contains(&recipe))
            .filter(|(known, _)| self::last(&known.name) == last && !known.values.is_table())
            .map(|(known, _)| format!("`{}`", known.name))
            .collect();
        same.dedup();
        match same.split_last()? {
            (one, []) => Some(format!("did you mean {one}?")),
            (one, more) => Some(format!("did you mean {} or {one}?", more.join(", "))),
        }
    }
}

/// The last part of a dotted key.
fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}
