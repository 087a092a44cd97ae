//! The config of a run: plain data with a schema.
//!
//! A config has the tables that every run has ([`Config`]) and those of the run's
//! [system](crate::systems). Every key has a default. [`load()`] reads a file with overrides,
//! [`validate`] refuses what cannot work before any work starts, and the resolved config is saved
//! beside the run.

mod difference;
mod error;
mod load;
mod model;
mod resume;
mod steering;
mod system_tables;
mod tables;

pub use difference::{Difference, difference};
pub use error::ConfigError;
pub(crate) use load::lay_over;
pub use load::{Place, load, load_over, override_trained, parse, to_toml};
pub use model::{ModelTable, NetworkKind};
pub use resume::{may_differ, must_continue};
pub use steering::SteeringConfig;
pub use system_tables::SystemTables;
pub use tables::{
    CheckpointConfig, Clip, EmaConfig, LrSchedule, OptimConfig, RunConfig, SamplingConfig,
    TrainConfig, ValidationConfig,
};

use kinegrad_data::DataConfig;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use toml::{Table, Value};

use crate::Error;
use crate::systems::Systems;

/// Everything a run is made from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Config {
    /// Name, seed, device.
    pub run: RunConfig,
    /// Where the motion comes from and how batches are made of it.
    pub data: DataConfig,
    /// The tables of the run's system, every key written out: a [`SystemTables`] reads them, and
    /// refuses those that are of nobody.
    #[serde(flatten)]
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
    /// Sampling settings of the trained model.
    pub sampling: SamplingConfig,
}

/// Why a config can be written.
const PLAIN: &str = "configs are plain data";

/// Names of the tables that every run has.
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

/// Reads a config from JSON by way of TOML; the system's tables stay as they stand.
pub(crate) fn from_json<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Config, D::Error> {
    let table = toml_table(serde_json::Map::deserialize(deserializer)?);
    load::from_table(&table, &|_| "its config".into()).map_err(D::Error::custom)
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

/// Rejects values that cannot work and returns what is doubtful.
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
