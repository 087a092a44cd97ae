//! The config of a run: plain data with a schema.
//!
//! A config consists of the tables that every run has ([`Config`]) and the tables of the run's
//! [system](crate::System). Every key has a default.
//! [`Systems::load`](crate::system::Systems::load) reads a file with overrides, and
//! [`Systems::validate`](crate::system::Systems::validate) rejects invalid settings. The run's
//! folder contains the resolved config.

mod difference;
mod document;
pub mod environment;
mod error;
mod length;
mod model;
mod origins;
mod resume;
mod resumed;
mod system_tables;
mod tables;

pub(crate) use difference::difference;
pub(crate) use document::{apply, from_table, value_at};
pub use document::{lay_over, to_toml};
pub use environment::EnvironmentSetting;
pub use error::ConfigError;
pub use length::RunLength;
pub(crate) use length::{alternative, both, give_way, must_have_one};
pub(crate) use model::names;
pub use model::{ModelTable, NetworkKind};
pub use origins::{Origin, Origins};
pub(crate) use resume::{may_differ, must_continue, must_have_recipe};
pub(crate) use resumed::{IgnoredKey, resumed};
pub use system_tables::{OwnTables, SystemTables};
pub(crate) use tables::validate;
pub use tables::{
    CheckpointConfig, ClipSample, EmaConfig, LrSchedule, OptimConfig, OptimPlace, ProductPrecision,
    RunConfig, SamplingConfig, SelectBy, TrainConfig, ValidationConfig, WeightDecayGroups,
};

pub use kinegrad_settings::Place;

use kinegrad_data::DataConfig;
use kinegrad_diffusion::{DiffusionConfig, NoiseSchedule};
use kinegrad_settings::InvalidSetting;
use schemars::JsonSchema;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use toml::{Table, Value};

/// Keys of the table `model` that do not belong to the network.
const MODEL_KEYS: [&str; 3] = ["kind", "size", "activation_checkpointing"];

/// The config of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Config {
    /// Name, seed, device.
    pub run: RunConfig,
    /// The dataset and its batches.
    pub data: DataConfig,
    /// The tables of the run's system.
    #[serde(flatten)]
    #[schemars(skip)]
    pub system: OwnTables,
    /// AdamW and its learning rate.
    pub optim: OptimConfig,
    /// The recipe and its length.
    pub train: TrainConfig,
    /// The moving average of the weights.
    pub ema: EmaConfig,
    /// Saving of checkpoints and the number to keep.
    pub checkpoint: CheckpointConfig,
    /// Validation on held-out motion.
    pub validation: ValidationConfig,
    /// Sampling settings of the trained model.
    pub sampling: SamplingConfig,
}

impl Config {
    /// The tables of the run's system.
    ///
    /// # Panics
    /// Panics if the tables have not been read as `T`.
    pub fn own<T: SystemTables>(&self) -> &T {
        self.system.get().expect("tables that the system has read")
    }

    /// The noise schedule of the config's diffusion process; `None` for systems without the table
    /// `diffusion`.
    ///
    /// # Errors
    /// Names the invalid key of the process.
    pub fn noise_schedule(&self) -> Result<Option<NoiseSchedule>, InvalidSetting> {
        let tables = self.system.to_table();
        let process = tables.get("diffusion").cloned();
        let process = process.and_then(|table| table.try_into::<DiffusionConfig>().ok());
        process
            .map(|process| NoiseSchedule::new(&process))
            .transpose()
    }

    /// The config with the system's tables replaced.
    #[must_use]
    pub fn with_own<T: SystemTables>(self, tables: T) -> Self {
        let system = OwnTables::new(tables);
        Self { system, ..self }
    }
}

/// The reason why serialization of a config cannot fail.
pub const PLAIN: &str = "configs are plain data";

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

/// Reads a config from JSON via TOML; the system's tables are unchanged.
pub fn from_json<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Config, D::Error> {
    let table = toml_table(serde_json::Map::deserialize(deserializer)?);
    from_table(&table, &|_| "its config".into()).map_err(D::Error::custom)
}

/// JSON as TOML; null values are omitted.
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

/// The config of `text` with `overrides`, without a system, for tests.
#[cfg(test)]
pub(crate) fn plain(text: &str, overrides: &[String]) -> Config {
    let mut table: toml::Table = text.parse().expect("TOML");
    for argument in overrides {
        apply(&mut table, argument).expect("an override");
    }
    from_table(&table, &|_| "c.toml".into()).expect("a config")
}
