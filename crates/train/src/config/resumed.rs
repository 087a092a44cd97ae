//! The config of a resumed run: the saved config with overrides.

use toml::{Table, Value};

use super::{Config, PLAIN, alternative, difference, may_differ, value_at};

/// A key of the config file that a resumed run ignores.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct IgnoredKey {
    /// Dotted key.
    pub key: String,
    /// Its value in the run's saved config, as JSON.
    pub saved: String,
    /// Its value in the config file, as JSON.
    pub given: String,
}

/// The config of a resumed run: `saved` with `overrides`. `given` is the config of file and
/// overrides, and `defaults` is the config without both.
///
/// Keys that [may differ](may_differ) and that only the file sets are ignored and returned, so that
/// a run started with overrides continues without repeating the overrides. Other keys of the file
/// are included; [`must_continue`](super::must_continue) refuses them.
pub(crate) fn resumed(
    saved: &Config,
    given: &Config,
    defaults: &Config,
    file: &Table,
    overrides: &[String],
) -> (Table, Vec<IgnoredKey>) {
    let is_set = |key: &str| {
        let mut set = overrides
            .iter()
            .filter_map(|argument| argument.split_once('='));
        let other = alternative(key);
        set.any(|(set, _)| is_of(key, set.trim()) || other.as_deref() == Some(set.trim()))
    };
    let not_default = difference(defaults, given).into_iter();
    let not_default: Vec<String> = not_default.map(|difference| difference.key).collect();
    let is_in_file = |key: &str| value_at(file, key).is_some();
    let mut ignored = Vec::new();
    let mut taken = Vec::new();
    for difference in difference(saved, given) {
        let key = &difference.key;
        if is_set(key) || (!may_differ(key) && (is_in_file(key) || not_default.contains(key))) {
            taken.push(difference.key);
        } else if may_differ(key) && is_in_file(key) {
            ignored.push(IgnoredKey {
                key: difference.key,
                saved: difference.left,
                given: difference.right,
            });
        }
    }
    let [mut table, given] = [saved, given].map(|config| Table::try_from(config).expect(PLAIN));
    for key in &taken {
        take(&mut table, &given, key);
    }
    (table, ignored)
}

/// True if a dotted key is `table` or below it.
pub(super) fn is_of(key: &str, table: &str) -> bool {
    let rest = key.strip_prefix(table);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Copies `key` from `from` to `table`, or removes the key if `from` does not have it.
fn take(table: &mut Table, from: &Table, key: &str) {
    match key.split_once('.') {
        None => match from.get(key) {
            Some(value) => drop(table.insert(key.into(), value.clone())),
            None => drop(table.remove(key)),
        },
        Some((name, rest)) => {
            let entry = table
                .entry(name.to_string())
                .or_insert_with(|| Value::Table(Table::new()));
            let empty = Table::new();
            let from = from.get(name).and_then(Value::as_table).unwrap_or(&empty);
            match entry {
                Value::Table(inner) => take(inner, from, rest),
                other => *other = Value::Table(from.clone()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::plain;

    fn config(text: &str, overrides: &[&str]) -> Config {
        let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
        plain(text, &overrides)
    }

    fn resume(file: &str, started_with: &[&str], overrides: &[&str]) -> (Config, Vec<String>) {
        let saved = config(file, started_with);
        let given = config(file, overrides);
        let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
        let table: Table = file.parse().expect("TOML");
        let (resumed, ignored) = resumed(&saved, &given, &config("", &[]), &table, &overrides);
        let text = toml::to_string(&resumed).expect("plain");
        let ignored = ignored.into_iter().map(|ignored| ignored.key).collect();
        (config(&text, &[]), ignored)
    }

    const FILE: &str = "[train]\nmax_steps = 600\n[run]\nname = \"a\"";

    #[test]
    fn what_a_run_was_started_with_stays_and_the_file_is_named() {
        let (config, ignored) = resume(FILE, &["train.max_steps=300"], &[]);
        assert_eq!(config.train.max_steps, Some(300));
        assert_eq!(ignored, ["train.max_steps"]);
        // A key that is not in the file gives no warning.
        let (config, ignored) = resume(FILE, &["checkpoint.keep_last=7"], &[]);
        assert_eq!(config.checkpoint.keep_last, 7);
        assert!(ignored.is_empty(), "{ignored:?}");
    }

    #[test]
    fn the_command_line_extends_a_run() {
        let (config, ignored) = resume(FILE, &["train.max_steps=300"], &["train.max_steps=600"]);
        assert_eq!((config.train.max_steps, ignored), (Some(600), Vec::new()));
        let (config, _) = resume(FILE, &[], &["data.source=elsewhere"]);
        assert_eq!(config.data.source.as_deref(), Some("elsewhere"));
    }

    #[test]
    fn epochs_and_steps_replace_each_other() {
        let (config, ignored) = resume(FILE, &["train.epochs=3"], &["train.max_steps=9"]);
        let length = (config.train.max_steps, config.train.epochs);
        assert_eq!((length, ignored), ((Some(9), None), Vec::new()));
        let (config, ignored) = resume("train = { epochs = 3 }", &[], &["train.max_steps=9"]);
        let length = (config.train.max_steps, config.train.epochs);
        assert_eq!((length, ignored), ((Some(9), None), Vec::new()));
        let (config, _) = resume(FILE, &[], &["train.epochs=4"]);
        let length = (config.train.max_steps, config.train.epochs);
        assert_eq!(length, (None, Some(4)));
        // The run was started with epochs; the file still has steps.
        let (config, ignored) = resume(FILE, &["train.epochs=3"], &[]);
        let length = (config.train.max_steps, config.train.epochs);
        assert_eq!(length, (None, Some(3)));
        assert_eq!(ignored, ["train.max_steps"]);
    }

    #[test]
    fn other_keys_of_the_command_line_stay_too_and_those_of_the_file_are_taken() {
        let (config, ignored) = resume(FILE, &["optim.learning_rate=0.5"], &[]);
        assert_eq!((config.optim.learning_rate, ignored), (0.5, Vec::new()));
        let file = "[optim]\nlearning_rate = 0.25";
        let (config, ignored) = resume(file, &["optim.learning_rate=0.5"], &[]);
        assert_eq!((config.optim.learning_rate, ignored), (0.25, Vec::new()));
    }
}
