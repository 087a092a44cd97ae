//! Lengths of the units that captures are written in.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Length of a unit of a BVH file.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case", try_from = "toml::Value")]
#[schemars(!try_from)]
pub enum Units {
    /// Metres.
    M,
    /// Centimetres, which most BVH files use.
    #[default]
    Cm,
    /// Millimetres.
    Mm,
    /// Inches.
    Inch,
    /// The unit of the CMU motion capture database: 2.54 / 0.45 cm.
    Cmu,
    /// Any number of metres.
    #[serde(untagged)]
    Metres(f64),
}

impl TryFrom<toml::Value> for Units {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        let found = match (value.as_str(), &value) {
            (_, toml::Value::Float(metres)) => return Ok(Self::Metres(*metres)),
            (_, toml::Value::Integer(metres)) => return Ok(Self::Metres(*metres as f64)),
            (Some("m"), _) => return Ok(Self::M),
            (Some("cm"), _) => return Ok(Self::Cm),
            (Some("mm"), _) => return Ok(Self::Mm),
            (Some("inch"), _) => return Ok(Self::Inch),
            (Some("cmu"), _) => return Ok(Self::Cmu),
            (Some(name), _) => format!("value: string {name:?}"),
            (None, other) => format!("type: {} `{other}`", other.type_str()),
        };
        let names = "\"m\", \"cm\", \"mm\", \"inch\", \"cmu\"";
        Err(format!(
            "invalid {found}, expected units: {names}, or a number of metres"
        ))
    }
}

impl Units {
    /// Metres of one unit.
    pub fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 0.01,
            Self::Mm => 0.001,
            Self::Inch => 0.0254,
            Self::Cmu => 0.0254 / 0.45,
            Self::Metres(metres) => metres,
        }
    }
}
