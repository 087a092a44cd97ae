//! The table `model`: `kind` selects the network, and `size` selects the defaults of the network's
//! keys. The network's settings read the other keys.

use kinegrad_models::NetworkConfig;
use kinegrad_settings::{DocumentError, Key, Name, Place, Values, not_among};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::document::{from_table, lay_over};
use super::{ConfigError, PLAIN};

/// The table `model` of a system whose networks are `N`: an enum that is tagged with the `kind`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelTable<N> {
    /// Named size that sets the defaults of the network's keys.
    pub size: String,
    /// The kind of network and its sizes.
    #[serde(flatten)]
    pub network: N,
    /// Recompute cheap activations in the backward pass instead of keeping them.
    #[serde(default)]
    pub activation_checkpointing: bool,
}

/// A kind of network that a system supports.
pub struct NetworkKind {
    name: &'static str,
    sizes: fn() -> Vec<&'static str>,
    keys: fn(&str, Table, Place<'_>) -> Result<Table, ConfigError>,
}

impl NetworkKind {
    /// The kind whose settings are `N`.
    pub const fn of<N: NetworkConfig>() -> Self {
        Self {
            name: N::KIND,
            sizes: || N::SIZES.iter().map(|(name, _)| *name).collect(),
            keys: keys::<N>,
        }
    }

    fn has(&self, key: &str) -> bool {
        let keys = (self.keys)((self.sizes)()[0], Table::new(), &|_| String::new());
        keys.is_ok_and(|keys| keys.contains_key(key))
    }
}

/// The keys of a network from `given`, with defaults from a size.
fn keys<N: NetworkConfig>(
    size: &str,
    given: Table,
    place: Place<'_>,
) -> Result<Table, ConfigError> {
    /// Makes errors name the table.
    #[derive(Deserialize)]
    struct Under<N> {
        model: N,
    }
    let named = N::SIZES.iter().find(|(name, _)| *name == size);
    let (_, of_size) = named.unwrap_or(&N::SIZES[0]);
    let mut keys = Table::try_from(of_size()).expect(PLAIN);
    lay_over(&mut keys, given);
    let under = Table::from_iter([("model".to_string(), Value::Table(keys))]);
    let mut network = from_table::<Under<N>>(&under, place)?.model;
    network.complete();
    Ok(Table::try_from(network).expect(PLAIN))
}

/// Lists the names of each kind's sizes at the key `model.size`.
pub(super) fn name_sizes(kinds: &[NetworkKind], keys: &mut Vec<Key>) {
    let Some(place) = keys.iter().position(|key| key.name == "model.size") else {
        return;
    };
    let size = keys.remove(place);
    let of_kind = |kind: &NetworkKind| Key {
        values: names(&(kind.sizes)()),
        only_with: Some(format!("model.kind = \"{}\"", kind.name)),
        ..size.clone()
    };
    keys.extend(kinds.iter().map(of_kind));
}

/// The table `model` with every key of its kind and size.
pub(super) fn complete(
    kinds: &[NetworkKind],
    mut given: Table,
    place: Place<'_>,
) -> Result<Table, ConfigError> {
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name).collect();
    let name = chosen(&mut given, "kind", &names, place)?;
    let kind = kinds
        .iter()
        .find(|kind| kind.name == name)
        .expect("one of them");
    let size = chosen(&mut given, "size", &(kind.sizes)(), place)?;
    let checkpointing = given.remove("activation_checkpointing");
    let keys = (kind.keys)(size, given, place).map_err(|error| of_other_kind(kinds, error))?;
    let mut table = Table::new();
    table.insert("kind".into(), name.into());
    table.insert("size".into(), size.into());
    table.extend(keys);
    table.extend(checkpointing.map(|value| ("activation_checkpointing".into(), value)));
    Ok(table)
}

/// Removes `key` from `given` and returns its value, one of `names`; without the key, the first
/// name.
fn chosen<'a>(
    given: &mut Table,
    key: &str,
    names: &[&'a str],
    place: Place<'_>,
) -> Result<&'a str, ConfigError> {
    let Some(found) = given.remove(key) else {
        return Ok(names[0]);
    };
    let named = names.iter().find(|name| found.as_str() == Some(name));
    named.copied().ok_or_else(|| {
        let key = format!("model.{key}");
        not_among(place(&key), &key, &found.to_string(), names).into()
    })
}

/// Adds the kind of network that has the unknown key to `error`.
fn of_other_kind(kinds: &[NetworkKind], mut error: ConfigError) -> ConfigError {
    if let ConfigError::Document(DocumentError::UnknownKey { key, hint, .. }) = &mut error {
        let own = key.strip_prefix("model.").unwrap_or(key);
        if let Some(other) = kinds.iter().find(|kind| kind.has(own)) {
            *hint = format!("it is a key of `model.kind = \"{}\"`", other.name);
        }
    }
    error
}

/// The values of a key that takes one of `names`.
pub fn names(names: &[&str]) -> Values {
    let name = |name: &&str| Name {
        name: (*name).to_owned(),
        meaning: String::new(),
    };
    Values::Names(names.iter().map(name).collect())
}
