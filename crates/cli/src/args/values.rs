//! Values of options.

use std::any::TypeId;
use std::fmt::Display;
use std::str::FromStr;

use serde::de::value::Error as ValueError;
use serde::de::{DeserializeOwned, IntoDeserializer};

/// A number from the command line.
pub fn number<N: FromStr + 'static>(text: &str) -> Result<N, String>
where
    N::Err: Display,
{
    let is_whole = TypeId::of::<N>() != TypeId::of::<f64>();
    text.parse().map_err(|error: N::Err| match is_whole {
        true if text.parse::<u128>().is_ok() => format!("{error}, allowed: at most {}", u64::MAX),
        true => "allowed: a whole number, 0 or more".to_string(),
        false => "allowed: a number, such as 1.5".to_string(),
    })
}

/// Parses a config enum by its serde name.
pub fn named<T: DeserializeOwned>(name: &str) -> Result<T, ValueError> {
    T::deserialize(name.into_deserializer())
}
