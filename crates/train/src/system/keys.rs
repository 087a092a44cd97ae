//! The config keys with meaning, values and defaults.

use kinegrad_settings::{InvalidSetting, Key, Values, keys_of};
use serde_json::Value as Json;
use toml::{Table, Value};

use super::Systems;
use crate::config::{Config, PLAIN, TrainConfig, apply, names, value_at};
use crate::error::Error;

/// A config key of some recipes.
#[derive(Clone, Debug)]
pub struct ConfigKey {
    /// Its description.
    pub key: Key,
    /// The recipes that have it.
    pub recipes: Vec<&'static str>,
    /// Each default, as TOML or `not set`, with its recipes; empty for tables.
    pub defaults: Vec<(Vec<&'static str>, String)>,
    /// A description of the accepted numbers, if restricted; see [`Systems::find_ranges`].
    pub range: Option<String>,
}

/// The keys of recipe and network.
const RECIPE: &str = "train.recipe";
const KIND: &str = "model.kind";

/// The text for a missing default.
const NOT_SET: &str = "not set";

/// A recipe with one kind of network and all of its defaults.
#[derive(Clone)]
pub struct Variant {
    /// Its name.
    pub recipe: &'static str,
    /// The setting that selects the variant.
    given: Table,
    /// The table with every key.
    complete: Table,
}

impl Variant {
    /// The dotted names of all keys.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        flatten(&self.complete, "", &mut names);
        names
    }

    /// True if keys that need `only_with`, such as `model.kind = "unet1d"`, are included.
    pub fn has(&self, only_with: Option<&str>) -> bool {
        let Some((key, value)) = only_with.and_then(|with| with.split_once(" = ")) else {
            return true;
        };
        let is_among = |found: &Value| value.split(", ").any(|value| found.to_string() == value);
        value_at(&self.complete, key).is_some_and(is_among)
    }
}

impl Systems<'_> {
    /// The description of every config key, with its recipes.
    pub fn described(self) -> Vec<(Key, Vec<&'static str>)> {
        let every: Vec<&'static str> = self.recipes().map(|recipe| recipe.name).collect();
        let mut described: Vec<(Key, Vec<&'static str>)> = Vec::new();
        for mut key in keys_of::<Config>() {
            if key.name == RECIPE {
                key.values = names(&every);
            }
            described.push((key, every.clone()));
        }
        for system in self.0 {
            let own = system.recipes().iter().map(|recipe| recipe.name);
            let own: Vec<&'static str> = own.collect();
            for key in system.keys() {
                match described.iter_mut().find(|(known, _)| *known == key) {
                    Some((_, recipes)) => recipes.extend(&own),
                    None => described.push((key, own.clone())),
                }
            }
        }
        described
    }

    /// Every config key, table by table.
    pub fn keys(self) -> Vec<ConfigKey> {
        let variants = self.variants();
        let order: Vec<String> = variants.iter().flat_map(Variant::names).collect();
        let place = |name: &str| {
            let place = order.iter().position(|known| known == name);
            place.unwrap_or(usize::MAX)
        };
        let keys = self.described().into_iter();
        let keys = keys.map(|(key, recipes)| ConfigKey {
            defaults: defaults(&key, &recipes, &variants),
            key,
            recipes,
            range: None,
        });
        let mut keys: Vec<ConfigKey> = keys.collect();
        // Tables in the order of configs, with their own keys before nested tables.
        keys.sort_by_key(|ConfigKey { key, .. }| {
            let home = match key.values.is_table() {
                true => key.name.as_str(),
                false => key.name.rsplit_once('.').map_or("", |(table, _)| table),
            };
            let first = home.split('.').next().unwrap_or_default();
            (
                place(first),
                first.to_owned(),
                place(home),
                home.to_owned(),
                place(&key.name),
            )
        });
        keys
    }

    /// Fills in the [range](ConfigKey::range) of `keys`, by validating extreme values.
    pub fn find_ranges(self, keys: &mut [ConfigKey]) {
        let bases = self.bases();
        for ConfigKey {
            key,
            recipes,
            range,
            ..
        } in keys
        {
            let mine = bases.iter().filter(|base| {
                recipes.contains(&base.recipe) && base.has(key.only_with.as_deref())
            });
            let probes = probes(&key.values);
            let mut tried = mine.flat_map(|base| probes.iter().map(move |value| (base, value)));
            *range = tried.find_map(|(base, value)| {
                let mut given = base.given.clone();
                apply(&mut given, &format!("{}={value}", key.name)).ok()?;
                let refused = self.refused(&given)?;
                let is_own = refused.key.starts_with(&key.name);
                is_own.then_some(refused.allowed)
            });
        }
    }

    /// Valid configs of every recipe, kind of network and kind of dataset.
    fn bases(self) -> Vec<Variant> {
        let keys = keys_of::<Config>();
        let kinds = keys.iter().find(|key| key.name == "data.kind");
        let kinds = kinds.map(|key| key.values.names()).unwrap_or_default();
        let mut bases = Vec::new();
        for variant in self.variants() {
            for kind in kinds {
                let data = format!(
                    "data = {{ kind = \"{}\", source = \"DATASET\" }}",
                    kind.name
                );
                let mut given = variant.given.clone();
                given.extend(data.parse::<Table>().expect("TOML of this file"));
                let config = self.read(&given, &|_| String::new());
                if config.is_ok_and(|config| self.validate(&config).is_ok()) {
                    bases.push(Variant {
                        given,
                        ..variant.clone()
                    });
                }
            }
        }
        bases
    }

    /// The invalid setting of a config.
    fn refused(self, given: &Table) -> Option<InvalidSetting> {
        let config = self.read(given, &|_| String::new()).ok()?;
        match self.validate(&config) {
            Err(Error::Setting(refused) | Error::Data(kinegrad_data::Error::Config(refused))) => {
                Some(refused)
            }
            _ => None,
        }
    }

    /// The variants of all recipes.
    pub fn variants(self) -> Vec<Variant> {
        let described = self.described();
        let mut variants = Vec::new();
        for recipe in self.recipes().map(|recipe| recipe.name) {
            let kinds = described
                .iter()
                .find(|(key, recipes)| key.name == KIND && recipes.contains(&recipe));
            let kinds = kinds.map(|(key, _)| key.values.names()).unwrap_or_default();
            let plain = format!("{RECIPE} = \"{recipe}\"\n");
            let others = kinds
                .iter()
                .map(|kind| format!("{plain}{KIND} = \"{}\"", kind.name));
            for text in [plain.clone()].into_iter().chain(others) {
                let given: Table = text.parse().expect("TOML of this file");
                let Ok(config) = self.read(&given, &|_| String::new()) else {
                    continue;
                };
                let complete = Table::try_from(config).expect(PLAIN);
                // Naming the default kind gives the first variant again.
                if !variants
                    .iter()
                    .any(|known: &Variant| known.complete == complete)
                {
                    variants.push(Variant {
                        recipe,
                        given,
                        complete,
                    });
                }
            }
        }
        variants
    }
}

fn defaults(
    key: &Key,
    recipes: &[&'static str],
    variants: &[Variant],
) -> Vec<(Vec<&'static str>, String)> {
    let mut defaults: Vec<(Vec<&'static str>, String)> = Vec::new();
    if key.values.is_table() {
        return defaults;
    }
    if key.name == RECIPE {
        let recipe = Value::from(TrainConfig::default().recipe);
        return vec![(recipes.to_vec(), written(&recipe))];
    }
    for variant in variants {
        // An explicit kind is not a default.
        if key.name == KIND && value_at(&variant.given, KIND).is_some() {
            continue;
        }
        if !recipes.contains(&variant.recipe) || !variant.has(key.only_with.as_deref()) {
            continue;
        }
        let value = match value_at(&variant.complete, &key.name) {
            Some(value) => written(value),
            None => key.default.as_ref().map_or(NOT_SET.to_owned(), toml_text),
        };
        match defaults.iter_mut().find(|(_, known)| *known == value) {
            Some((recipes, _)) if recipes.contains(&variant.recipe) => {}
            Some((recipes, _)) => recipes.push(variant.recipe),
            None => defaults.push((vec![variant.recipe], value)),
        }
    }
    defaults
}

/// Formats JSON as TOML.
pub fn toml_text(json: &Json) -> String {
    match json {
        Json::Null => NOT_SET.to_owned(),
        json => Value::try_from(json).map_or(NOT_SET.to_owned(), |value| written(&value)),
    }
}

/// Formats a value as TOML, small numbers with an exponent.
fn written(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{number:?}"),
        value => value.to_string(),
    }
}

/// Appends all dotted keys, tables included, in order.
fn flatten(table: &Table, prefix: &str, names: &mut Vec<String>) {
    for (name, value) in table {
        let name = format!("{prefix}{name}");
        names.push(name.clone());
        if let Value::Table(inner) = value {
            flatten(inner, &format!("{name}."), names);
        }
    }
}

/// Extreme values for a key of numbers, as TOML.
fn probes(values: &Values) -> Vec<String> {
    let numbers: &[&str] = match values {
        Values::Count => &["0", "9223372036854775807"],
        Values::Integer => &["-9223372036854775808", "0", "9223372036854775807"],
        Values::Number => &["-1e300", "0.0", "1e300"],
        Values::List(values, length) => {
            let length = length.unwrap_or(1) as usize;
            let repeated = |value: String| format!("[{}]", vec![value; length].join(", "));
            return probes(values).into_iter().map(repeated).collect();
        }
        _ => &[],
    };
    numbers.iter().map(ToString::to_string).collect()
}
