//! The tables of a config that belong to one system.

use kinegrad_settings::{Key, keys_of};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::{Config, ConfigError, NetworkKind, PLAIN, Place, document, model};

/// The tables of a system as a struct: one field a table.
pub trait SystemTables: Serialize + DeserializeOwned {
    /// Kinds of network that the table `model` may be of, the default first; none of a system
    /// without that table.
    const NETWORKS: &'static [NetworkKind] = &[];

    /// Reads them from `tables`; `place` says where a dotted key stands.
    ///
    /// # Errors
    /// Names the place of a thing that is wrong.
    fn read(tables: &Table, place: Place<'_>) -> Result<Self, ConfigError> {
        let mut tables = tables.clone();
        if !Self::NETWORKS.is_empty() {
            let model = tables
                .entry("model")
                .or_insert_with(|| Value::Table(Table::new()));
            // What is no table is refused below.
            if let Value::Table(model) = model {
                *model = model::complete(Self::NETWORKS, std::mem::take(model), place)?;
            }
        }
        document::from_table(&tables, place)
    }

    /// Those of a run's config.
    ///
    /// # Errors
    /// Names a key that is wrong; not for a config that
    /// [`Systems::load`](crate::system::Systems::load) has read.
    fn of(config: &Config) -> Result<Self, ConfigError> {
        Self::read(&config.system, &|_| "the run's config".into())
    }

    /// Their keys, with what the doc comments of the struct say of them.
    fn keys() -> Vec<Key>
    where
        Self: JsonSchema,
    {
        let mut keys = keys_of::<Self>();
        model::name_sizes(Self::NETWORKS, &mut keys);
        keys
    }

    /// The tables as plain data, every key written out.
    fn to_table(self) -> Table {
        Table::try_from(self).expect(PLAIN)
    }
}
