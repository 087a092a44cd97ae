//! Lengths of the units that captures are written in.

use std::fmt;

use serde::de::{self, IntoDeserializer, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Length of a unit of a BVH file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Units {
    /// A named unit.
    Named(NamedUnit),
    /// Metres.
    Metres(f64),
}

/// Units with a name.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NamedUnit {
    /// Metres.
    M,
    /// Centimetres, which most BVH files use.
    Cm,
    /// Millimetres.
    Mm,
    /// Inches.
    Inch,
    /// The unit of the CMU motion capture database: 2.54 / 0.45 cm.
    Cmu,
}

impl Default for Units {
    fn default() -> Self {
        Self::Named(NamedUnit::Cm)
    }
}

/// By hand: serde's own words for a value that is neither say nothing of what is allowed.
impl<'de> Deserialize<'de> for Units {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;

        impl Visitor<'_> for Either {
            type Value = Units;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(
                    "units: \"m\", \"cm\", \"mm\", \"inch\", \"cmu\", or a number of metres",
                )
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<Units, E> {
                NamedUnit::deserialize(name.into_deserializer())
                    .map(Units::Named)
                    .map_err(|_: E| E::invalid_value(Unexpected::Str(name), &self))
            }

            fn visit_f64<E>(self, metres: f64) -> Result<Units, E> {
                Ok(Units::Metres(metres))
            }

            fn visit_i64<E>(self, metres: i64) -> Result<Units, E> {
                Ok(Units::Metres(metres as f64))
            }
        }

        deserializer.deserialize_any(Either)
    }
}

impl Units {
    /// Metres of one unit.
    pub fn metres(self) -> f64 {
        match self {
            Self::Metres(metres) => metres,
            Self::Named(NamedUnit::M) => 1.0,
            Self::Named(NamedUnit::Cm) => 0.01,
            Self::Named(NamedUnit::Mm) => 0.001,
            Self::Named(NamedUnit::Inch) => 0.0254,
            Self::Named(NamedUnit::Cmu) => 0.0254 / 0.45,
        }
    }
}
