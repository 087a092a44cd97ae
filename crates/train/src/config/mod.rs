//! The config of a run: plain data with a schema.
//!
//! A config has the tables that every run has ([`Config`]) and those of the run's
//! [system](crate::systems). Every key has a default. [`load()`] reads a file with overrides,
//! [`validate`] refuses what cannot work before any work starts, and the resolved config is saved
//! beside the run.

mod difference;
mod error;
mod load;
mod resume;
mod steering;
mod system_tables;
mod tables;

pub use difference::{Difference, difference};
pub use error::ConfigError;
pub(crate) use load::lay_over;
pub use load::{load, load_over, override_trained, parse, to_toml};
pub use resume::{may_differ, must_continue};
pub use steering::SteeringConfig;
pub use system_tables::SystemTables;
pub use tables::{
    CheckpointConfig, Clip, EmaConfig, LrSchedule, OptimConfig, RunConfig, SamplingConfig,
    TrainConfig, ValidationConfig,
};

use kinegrad_data::DataConfig;
use serde::de::Error as _;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::{Table, Value};

use crate::Error;
use crate::systems::Systems;

/// Everything a run is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Name, seed, device.
    pub run: RunConfig,
    /// Where the motion comes from and how batches are made of it.
    pub data: DataConfig,
    /// The tables of the run's system, every key written out: a [`SystemTables`] reads them.
    pub system: Table,
    /// AdamW and its learning rate.
    pub optim: OptimConfig,
    /// Which training, how long.
    pub train: TrainConfig,
    /// The moving average of the weights.
    pub ema: EmaConfig,
    /// When to save and what to keep.
    pub checkpoint: CheckpointConfig,
    /// When and how to measure on held-out motion.
    pub validation: ValidationConfig,
    /// How to draw samples from the trained model.
    pub sampling: SamplingConfig,
}

/// The tables that every run has.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct CommonTables {
    run: RunConfig,
    data: DataConfig,
    optim: OptimConfig,
    train: TrainConfig,
    ema: EmaConfig,
    checkpoint: CheckpointConfig,
    validation: ValidationConfig,
    sampling: SamplingConfig,
}

/// Names of [`CommonTables`].
const COMMON: [&str; 8] = [
    "run",
    "data",
    "optim",
    "train",
    "ema",
    "checkpoint",
    "validation",
    "sampling",
];

/// The tables of `whole` that every run has, and the others.
fn split(whole: Table) -> (Table, Table) {
    let common = |(name, _): &(String, Value)| COMMON.contains(&name.as_str());
    whole.into_iter().partition(common)
}

impl Config {
    fn of(common: CommonTables, system: Table) -> Self {
        let CommonTables {
            run,
            data,
            optim,
            train,
            ema,
            checkpoint,
            validation,
            sampling,
        } = common;
        Self {
            run,
            data,
            system,
            optim,
            train,
            ema,
            checkpoint,
            validation,
            sampling,
        }
    }
}

impl Serialize for Config {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("run", &self.run)?;
        map.serialize_entry("data", &self.data)?;
        for (name, table) in &self.system {
            map.serialize_entry(name, table)?;
        }
        map.serialize_entry("optim", &self.optim)?;
        map.serialize_entry("train", &self.train)?;
        map.serialize_entry("ema", &self.ema)?;
        map.serialize_entry("checkpoint", &self.checkpoint)?;
        map.serialize_entry("validation", &self.validation)?;
        map.serialize_entry("sampling", &self.sampling)?;
        map.end()
    }
}

/// Takes the system's tables as they stand: only the system can read them.
impl<'de> Deserialize<'de> for Config {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let json = serde_json::Map::deserialize(deserializer)?;
        let (common, system) = split(toml_table(json));
        let common = load::from_table(&common, &|_| "its config".into());
        Ok(Self::of(common.map_err(D::Error::custom)?, system))
    }
}

/// JSON as TOML, which says that there is no value by leaving its key out.
fn toml_table(json: serde_json::Map<String, serde_json::Value>) -> Table {
    let entries = json.into_iter();
    let entries = entries.filter_map(|(key, value)| Some((key, toml_value(value)?)));
    entries.collect()
}

fn toml_value(json: serde_json::Value) -> Option<Value> {
    Some(match json {
        serde_json::Value::Null => return None,
        serde_json::Value::Bool(value) => Value::Boolean(value),
        serde_json::Value::Number(number) => match number.as_i64() {
            Some(integer) => Value::Integer(integer),
            None => Value::Float(number.as_f64()?),
        },
        serde_json::Value::String(text) => Value::String(text),
        serde_json::Value::Array(values) => {
            Value::Array(values.into_iter().filter_map(toml_value).collect())
        }
        serde_json::Value::Object(map) => Value::Table(toml_table(map)),
    })
}

/// Refuses values that cannot work and returns what is doubtful.
///
/// # Errors
/// Names the first key with a bad value, what it is, what is allowed and how to mend it.
pub fn validate(systems: Systems<'_>, config: &Config) -> Result<Vec<String>, Error> {
    let (system, recipe) = systems.of(config)?;
    config.data.validate()?;
    tables::validate(config, recipe)?;
    let mut warnings = system.validate(config)?;
    if config.optim.warmup_steps > config.train.max_steps {
        warnings.push(format!(
            "`optim.warmup_steps` ({}) is longer than `train.max_steps` ({}): the learning rate \
             never reaches `optim.learning_rate`",
            config.optim.warmup_steps, config.train.max_steps
        ));
    }
    Ok(warnings)
}
