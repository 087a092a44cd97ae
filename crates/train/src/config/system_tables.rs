//! The tables of a config that belong to one system.

use std::any::Any;
use std::fmt;
use std::sync::Arc;

use kinegrad_settings::{Key, keys_of};
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::{Table, Value};

use super::{ConfigError, NetworkKind, PLAIN, Place, document, model};

/// The tables of the system in a config, as plain data until
/// [`System::complete`](crate::system::System::complete) deserializes them.
#[derive(Clone)]
pub struct OwnTables(Arc<dyn AnyTables>);

trait AnyTables: Any + Send + Sync {
    fn to_table(&self) -> Table;
}

/// Tables that no system has deserialized.
struct Unread(Table);

impl AnyTables for Unread {
    fn to_table(&self) -> Table {
        self.0.clone()
    }
}

impl<T: SystemTables> AnyTables for T {
    fn to_table(&self) -> Table {
        Table::try_from(self).expect(PLAIN)
    }
}

impl OwnTables {
    /// Tables as a system's struct.
    pub fn new<T: SystemTables>(tables: T) -> Self {
        Self(Arc::new(tables))
    }

    /// Tables as plain data.
    pub fn unread(tables: Table) -> Self {
        Self(Arc::new(Unread(tables)))
    }

    /// The system's struct; `None` if the struct has another type.
    pub fn get<T: SystemTables>(&self) -> Option<&T> {
        let tables: &dyn Any = &*self.0;
        tables.downcast_ref()
    }

    /// The tables as plain data; a system's struct gives every key.
    pub fn to_table(&self) -> Table {
        self.0.to_table()
    }
}

impl Default for OwnTables {
    fn default() -> Self {
        Self::unread(Table::new())
    }
}

impl fmt::Debug for OwnTables {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_table().fmt(formatter)
    }
}

impl PartialEq for OwnTables {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.to_table() == other.to_table()
    }
}

impl Serialize for OwnTables {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.to_table().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for OwnTables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::unread(Table::deserialize(deserializer)?))
    }
}

/// The tables of a system as a struct with one field per table.
pub trait SystemTables: Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Kinds of network for the table `model`, the default first; empty without a table `model`.
    const NETWORKS: &'static [NetworkKind] = &[];

    /// Deserializes `tables`; `place` locates a dotted key.
    ///
    /// # Errors
    /// Names the location of the fault.
    fn read(tables: &Table, place: Place<'_>) -> Result<Self, ConfigError> {
        let mut tables = tables.clone();
        if !Self::NETWORKS.is_empty() {
            let model = tables
                .entry("model")
                .or_insert_with(|| Value::Table(Table::new()));
            // Values that are not tables are refused below.
            if let Value::Table(model) = model {
                *model = model::complete(Self::NETWORKS, std::mem::take(model), place)?;
            }
        }
        document::from_table(&tables, place)
    }

    /// The keys of the tables, described by the struct's doc comments.
    fn keys() -> Vec<Key>
    where
        Self: JsonSchema,
    {
        let mut keys = keys_of::<Self>();
        model::name_sizes(Self::NETWORKS, &mut keys);
        keys
    }
}
