//! The origin of each value of a config.

use std::fmt;

use toml::{Table, Value};

use super::resumed::is_of;
use super::{Config, EnvironmentSetting, to_toml};

/// The sources of a config's values.
#[derive(Clone, Debug, Default)]
pub struct Origins {
    /// Keys of the command line.
    pub(crate) overrides: Vec<String>,
    /// The settings of the environment that apply.
    pub(crate) environment: Vec<EnvironmentSetting>,
    /// The config file.
    pub(crate) file: Table,
    /// The values inherited from initial checkpoints.
    pub(crate) inherited: Table,
}

/// The origin of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Option `set`.
    CommandLine,
    /// An environment variable.
    Environment(&'static str),
    /// The config file.
    File,
    /// The initial checkpoint.
    Inherited,
    /// The default of the recipe or the size of the model.
    Default,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CommandLine => f.write_str("command line"),
            Self::Environment(variable) => write!(f, "environment, {variable}"),
            Self::File => f.write_str("file"),
            Self::Inherited => f.write_str("initial checkpoint"),
            Self::Default => f.write_str("default"),
        }
    }
}

impl Origins {
    /// The origin of the value at `path`, the names of its tables and its key.
    pub fn of(&self, path: &[String]) -> Origin {
        let key = path.join(".");
        let variable = self.environment.iter().find(|setting| setting.key == key);
        if self.overrides.iter().any(|set| is_of(&key, set)) {
            Origin::CommandLine
        } else if let Some(setting) = variable {
            Origin::Environment(setting.variable)
        } else if contains(&self.file, path) {
            Origin::File
        } else if contains(&self.inherited, path) {
            Origin::Inherited
        } else {
            Origin::Default
        }
    }

    /// The config as TOML text, each value with its origin as a comment.
    pub fn annotated(&self, config: &Config) -> String {
        let text = to_toml(config);
        let mut tables = Vec::new();
        let lines = text.lines().map(|line| match only_path(line) {
            None => line.to_owned(),
            Some(path) if line.starts_with('[') => {
                tables = path;
                line.to_owned()
            }
            Some(key) => {
                let path: Vec<String> = tables.iter().chain(&key).cloned().collect();
                format!("{line}  # {}", self.of(&path))
            }
        });
        let annotated = lines.collect::<Vec<_>>().join("\n");
        // Comments would become part of a value of several lines.
        match annotated.parse::<Table>().ok() == text.parse().ok() {
            true => annotated,
            false => text,
        }
    }
}

/// True if `table` has a value at `path`, or a list on the way to it.
fn contains(table: &Table, path: &[String]) -> bool {
    let mut table = table;
    for (index, name) in path.iter().enumerate() {
        match table.get(name) {
            Some(Value::Table(inner)) if index + 1 < path.len() => table = inner,
            found => return found.is_some(),
        }
    }
    true
}

/// The names of the tables of a header, or the key of a line `key = value`.
fn only_path(line: &str) -> Option<Vec<String>> {
    let mut table: Table = line.parse().ok()?;
    let mut path = Vec::new();
    loop {
        let (name, value) = table.into_iter().next()?;
        path.push(name);
        match value {
            Value::Table(inner) if line.starts_with('[') && !inner.is_empty() => table = inner,
            _ => return Some(path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::plain;

    fn path(key: &str) -> Vec<String> {
        key.split('.').map(str::to_owned).collect()
    }

    #[test]
    fn the_command_line_wins_over_the_environment_and_that_over_the_file() {
        let setting = |variable, key| EnvironmentSetting {
            variable,
            key,
            value: "x".into(),
        };
        let text = "run = { device = \"cpu\", seed = 1 }\ndata = { source = \"there\" }\n\
                    optim = { betas = [0.1, 0.2] }";
        let origins = Origins {
            overrides: vec!["run.device".into(), "ema".into()],
            environment: vec![
                setting("KINEGRAD_DEVICE", "run.device"),
                setting("KINEGRAD_DATA_SOURCE", "data.source"),
            ],
            file: text.parse().unwrap(),
            inherited: "data = { validation = { fraction = 0.1 } }"
                .parse()
                .unwrap(),
        };
        for (key, expected) in [
            ("run.device", "command line"),
            ("ema.decay", "command line"),
            ("data.source", "environment, KINEGRAD_DATA_SOURCE"),
            ("run.seed", "file"),
            ("optim.betas", "file"),
            ("data.validation.fraction", "initial checkpoint"),
            ("optim.eps", "default"),
        ] {
            assert_eq!(origins.of(&path(key)).to_string(), expected, "{key}");
        }
    }

    #[test]
    fn every_value_has_its_origin_and_the_text_stays_the_config() {
        let config = plain(
            "run = { seed = 7 }\ndata = { labels = { \"C_*.1\" = \"[a] # b\" } }",
            &[],
        );
        let origins = Origins {
            file: "run = { seed = 7 }\ndata = { labels = { \"C_*.1\" = \"[a] # b\" } }"
                .parse()
                .unwrap(),
            ..Origins::default()
        };
        let text = origins.annotated(&config);
        assert_eq!(plain(&text, &[]), config);
        for line in ["seed = 7  # file", "\"C_*.1\" = \"[a] # b\"  # file"] {
            assert!(text.lines().any(|found| found == line), "{line}: {text}");
        }
        for line in text.lines().filter(|line| line.contains(" = ")) {
            assert!(line.contains("  # "), "{line}");
        }
    }
}
