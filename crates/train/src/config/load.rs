//! From a file and `KEY=VALUE` overrides to a [`Config`], with errors that name file, line, key,
//! what was found and what is allowed.

use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{COMMON, Config, ConfigError, PLAIN, TrainConfig, model};
use crate::systems::Systems;

/// Says where a dotted key stands, such as `FILE:LINE`.
pub type Place<'a> = &'a dyn Fn(&str) -> String;

/// Reads the config at `path` and applies `overrides` of the form `a.b=value` in order.
///
/// # Errors
/// Names file and line, or the override, of a thing that is wrong.
pub fn load(
    systems: Systems<'_>,
    path: &Path,
    overrides: &[String],
) -> Result<Config, ConfigError> {
    let origin = path.display().to_string();
    parse(systems, &read(path)?, &origin, overrides)
}

/// [`load()`] where `beneath` says what the file and the overrides leave out.
///
/// # Errors
/// As [`load()`].
pub fn load_over(
    systems: Systems<'_>,
    path: &Path,
    overrides: &[String],
    beneath: &Table,
) -> Result<Config, ConfigError> {
    // Errors of the file by itself name its lines.
    load(systems, path, overrides)?;
    let text = read(path)?;
    let mut table = beneath.clone();
    lay_over(&mut table, text.parse().expect("text that was just parsed"));
    for argument in overrides {
        apply(&mut table, argument)?;
    }
    whole(systems, &table, &|_| path.display().to_string())
}

fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|source| ConfigError::Read {
        path: path.to_path_buf(),
        source,
    })
}

/// [`load()`] from text; `origin` stands for the file in errors.
///
/// # Errors
/// As [`load()`].
pub fn parse(
    systems: Systems<'_>,
    text: &str,
    origin: &str,
    overrides: &[String],
) -> Result<Config, ConfigError> {
    let no_toml = |error: toml::de::Error| {
        let line = error.span().map(|span| line_of(text, span.start));
        ConfigError::Syntax {
            place: place(origin, line),
            message: error.message().to_string(),
        }
    };
    let spans = DeTable::parse(text).map_err(no_toml)?;
    // Numbers are read only here, and may be too large.
    let mut table: Table = text.parse().map_err(no_toml)?;
    let mut config = whole(systems, &table, &|key| {
        let start = start_of(spans.get_ref(), key);
        place(origin, start.map(|start| line_of(text, start)))
    })?;
    for argument in overrides {
        apply(&mut table, argument)?;
        // Read after each one, so that an error belongs to it.
        config = whole(systems, &table, &|_| format!("--set {argument}"))?;
    }
    Ok(config)
}

/// Tables whose keys may change once a model is trained.
const OF_TRAINED: [&str; 2] = ["sampling.", "evaluation."];

/// A trained run's config with `overrides` of its sampling and evaluation settings.
///
/// # Errors
/// Names the override that is wrong, or whose key is of another table.
pub fn override_trained(
    systems: Systems<'_>,
    config: &Config,
    overrides: &[String],
) -> Result<Config, ConfigError> {
    let mut table = Table::try_from(config).expect(PLAIN);
    let mut changed = config.clone();
    for argument in overrides {
        let key = argument.trim_start();
        if !OF_TRAINED.iter().any(|table| key.starts_with(table)) {
            return Err(ConfigError::Trained {
                argument: argument.clone(),
            });
        }
        apply(&mut table, argument)?;
        changed = whole(systems, &table, &|_| format!("--set {argument}"))?;
    }
    Ok(changed)
}

/// The config of `given`, where what it leaves out is as its recipe has it.
fn whole(systems: Systems<'_>, given: &Table, place: Place<'_>) -> Result<Config, ConfigError> {
    let named = given.get("train").and_then(|train| train.get("recipe"));
    let default = TrainConfig::default().recipe;
    // What is no text is refused below.
    let name = named.and_then(Value::as_str).unwrap_or(&default);
    let (system, recipe) = systems.of_recipe(name).ok_or_else(|| {
        let names: Vec<&str> = systems.recipes().map(|recipe| recipe.name).collect();
        let key = "train.recipe";
        not_among(place(key), key, &format!("\"{name}\""), &names)
    })?;
    let mut table = system.defaults(recipe, given);
    lay_over(&mut table, given.clone());
    let config: Config = from_table(&table, place)?;
    let system = system.complete(&config.system, place)?;
    Ok(Config { system, ..config })
}

/// The error of a value that is none of the `names` that `key` may have.
pub(super) fn not_among(place: String, key: &str, found: &str, names: &[&str]) -> ConfigError {
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
pub(super) fn from_table<T: DeserializeOwned>(
    table: &Table,
    place: Place<'_>,
) -> Result<T, ConfigError> {
    serde_path_to_error::deserialize(Value::Table(table.clone()))
        .map_err(|error| explain(place, &error.path().to_string(), error.inner().message()))
}

/// Sets one dotted key; a value that is not TOML is taken as text, so that `run.device=cpu` needs
/// no quotes in a shell.
fn apply(table: &mut Table, argument: &str) -> Result<(), ConfigError> {
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
            place: format!("--set {argument}"),
            key: key.to_string(),
            message: format!("`{parent}` is a value, not a table"),
            hint: "keys are written table.key".into(),
        })?;
    }
    current.insert(last.to_string(), value);
    Ok(())
}

fn place(origin: &str, line: Option<usize>) -> String {
    match line {
        Some(line) => format!("{origin}:{line}"),
        None => origin.to_string(),
    }
}

/// The hint that fits every key.
const SHOW: &str = "`kinegrad config show CONFIG` prints every key with its value";

/// The line of a byte, counted from 1.
fn line_of(text: &str, byte: usize) -> usize {
    text[..byte.min(text.len())].matches('\n').count() + 1
}

/// Where `path`, such as `model.channel_mult[2]`, stands in the text that `table` was parsed from, or
/// the nearest key above it.
fn start_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
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
            "model" => &model::KEYS,
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
        message: message.to_string(),
        hint: SHOW.into(),
    }
}

fn nearest<'a>(found: &str, allowed: &[&'a str]) -> Option<&'a str> {
    let similar = |name: &&'a str| (strsim::jaro_winkler(found, name), *name);
    let near = allowed.iter().map(similar).filter(|near| near.0 > 0.75);
    near.max_by(|a, b| a.0.total_cmp(&b.0)).map(|near| near.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::systems::BUILT_IN;

    fn error(text: &str, overrides: &[&str]) -> String {
        let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
        let error = parse(BUILT_IN, text, "c.toml", &overrides).expect_err("a bad config");
        let help = miette::Diagnostic::help(&error)
            .map(|h| h.to_string())
            .unwrap_or_default();
        format!("{error}\nhint: {help}")
    }

    #[test]
    fn an_unknown_key_names_line_table_and_neighbour() {
        let text = error("[optim]\n\nlerning_rate = 1.0\n", &[]);
        assert!(
            text.contains("c.toml:3: unknown key `optim.lerning_rate`"),
            "{text}"
        );
        assert!(
            text.contains("did you mean `optim.learning_rate`?"),
            "{text}"
        );
    }

    #[test]
    fn an_unknown_table_names_its_neighbour() {
        let text = error("[optin]\nlearning_rate = 1.0\n", &[]);
        assert!(text.contains("c.toml:1: unknown key `optin`"), "{text}");
        assert!(text.contains("did you mean `optim`?"), "{text}");
    }

    #[test]
    fn a_wrong_type_names_line_and_key() {
        let text = error("[train]\nmax_steps = \"many\"\n", &[]);
        assert!(
            text.contains("c.toml:2: `train.max_steps`: invalid type"),
            "{text}"
        );
        let text = error("[train]\nmax_steps = -5\n", &[]);
        assert!(text.contains("c.toml:2: `train.max_steps`"), "{text}");
    }

    #[test]
    fn numbers_that_no_type_holds_name_their_line() {
        for number in ["99999999999999999999", "18446744073709551615"] {
            let text = error(&format!("[run]\nname = \"x\"\nseed = {number}\n"), &[]);
            assert!(text.starts_with("c.toml:3"), "{text}");
        }
    }

    #[test]
    fn keys_with_dots_and_elements_of_lists_name_their_line() {
        for (text, place) in [
            (
                "[optim.groups]\nunet = 1e-4\n\"unet.dec\" = \"x\"\n",
                "c.toml:3: ",
            ),
            ("[model]\nchannel_mult = [\n1,\n\"x\"]\n", "c.toml:4: "),
            (
                "model.size = \"tiny\"\nmodel.dropout = \"x\"\n",
                "c.toml:2: ",
            ),
            ("[model]\nsize = \"tiny\"\n\"a.b\" = 1\n", "c.toml:3: "),
        ] {
            let error = error(text, &[]);
            assert!(error.starts_with(place), "{text}: {error}");
        }
    }

    #[test]
    fn an_unknown_choice_names_the_nearest() {
        let text = error("[diffusion]\nbeta_schedule = \"cosin\"\n", &[]);
        assert!(text.contains("did you mean \"cosine\"?"), "{text}");
    }

    #[test]
    fn an_override_is_blamed_for_its_own_error() {
        let text = error("", &["run.seed=3", "run.sead=3"]);
        assert!(
            text.contains("--set run.sead=3: unknown key `run.sead`"),
            "{text}"
        );
        assert!(error("", &["run.seed"]).contains("is not KEY=VALUE"));
    }

    #[test]
    fn overrides_win_in_order_and_text_needs_no_quotes() {
        let overrides = ["run.seed=3", "run.device=cpu", "run.seed=4"].map(String::from);
        let config = parse(BUILT_IN, "[run]\nseed = 1\n", "c.toml", &overrides);
        let config = config.expect("a good config");
        assert_eq!((config.run.seed, config.run.device.as_str()), (4, "cpu"));
    }

    #[test]
    fn the_written_config_reads_back_equal() {
        for recipe in BUILT_IN.recipes() {
            let text = format!("[train]\nrecipe = \"{}\"", recipe.name);
            let config = parse(BUILT_IN, &text, "c.toml", &[]).expect("defaults");
            let again = parse(BUILT_IN, &to_toml(&config), "c.toml", &[]).expect("own output");
            assert_eq!(again, config);
            let json = serde_json::to_string(&config).expect("plain data");
            let mut json = serde_json::Deserializer::from_str(&json);
            let read = super::super::from_json(&mut json);
            assert_eq!(read.expect("own output"), config);
        }
    }

    #[test]
    fn an_unknown_recipe_names_the_known_ones() {
        let text = error("[train]\n\nrecipe = \"gmd_movement\"\n", &[]);
        assert!(
            text.starts_with("c.toml:3: `train.recipe`: \"gmd_movement\" is not among"),
            "{text}"
        );
        assert!(
            text.contains("diffusion, decoder, e2e") && text.contains("\"gmd_motion\"?"),
            "{text}"
        );
    }
}
