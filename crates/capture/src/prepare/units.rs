//! Lengths of the units that captures are written in.

use serde::{Deserialize, Serialize};

/// Length of a unit of a BVH file.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(untagged, try_from = "toml::Value")]
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

impl TryFrom<toml::Value> for Units {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        if let Ok(name) = NamedUnit::deserialize(value.clone()) {
            return Ok(Self::Named(name));
        }
        let found = match value {
            toml::Value::Float(metres) => return Ok(Self::Metres(metres)),
            toml::Value::Integer(metres) => return Ok(Self::Metres(metres as f64)),
            toml::Value::String(name) => format!("value: string {name:?}"),
            other => format!("type: {} `{other}`", other.type_str()),
        };
        Err(format!(
            "invalid {found}, expected units: \"m\", \"cm\", \"mm\", \"inch\", \"cmu\", or a \
             number of metres"
        ))
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
