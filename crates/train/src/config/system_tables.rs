//! The tables of a config that belong to one system.

use kinegrad_settings::{Key, keys_of};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::{Config, ConfigError, NetworkKind, PLAIN, Place, document, model};

/// The tables of a system as a struct: one field a table.
pub trait SystemTables: Serialize + DeserializeOwned {
    /// TOML of keys that kinegrad 0.1 wrote into every config, whatever its recipe, with the values
    /// that they had where nobody set them: such a key with such a value is passed over.
    const PASSED_OVER: &'static str = "";

    /// Kinds of network that the table `model` may be of, the default first; none of a system
    /// without that table.
    const NETWORKS: &'static [NetworkKind] = &[];

    /// Reads them from `tables`; `place` says where a dotted key stands.
    ///
    /// # Errors
    /// Names the place of a thing that is wrong.
    fn read(tables: &Table, place: Place<'_>) -> Result<Self, ConfigError> {
        let mut tables = tables.clone();
        let passed_over = Self::PASSED_OVER.parse().expect("text of a program");
        remove(&mut tables, &passed_over);
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

/// Removes the values of `unwanted` from `table`, and tables that are empty then.
fn remove(table: &mut Table, unwanted: &Table) {
    for (key, value) in unwanted {
        let gone = match (table.get_mut(key), value) {
            (Some(Value::Table(inner)), Value::Table(unwanted)) => {
                remove(inner, unwanted);
                inner.is_empty()
            }
            (Some(found), value) => found == value,
            (None, _) => false,
        };
        if gone {
            table.remove(key);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_keys_with_the_unwanted_value_are_passed_over() {
        let mut table: Table = "a = 1\nb = 2\n[t]\nc = 3\n[u]\nd = 4\ne = 5"
            .parse()
            .expect("TOML");
        let unwanted = "a = 1\nb = 3\n[t]\nc = 3\n[u]\nd = 4"
            .parse()
            .expect("TOML");
        remove(&mut table, &unwanted);
        assert_eq!(table, "b = 2\n[u]\ne = 5".parse().expect("TOML"));
    }
}
