//! LoRA adapters of selected layers.

use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Initializer;
use crate::config::MAX_WIDTH;

/// Layers with adapters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LoraTarget {
    /// All projections of the self- and cross-attention blocks.
    Attention,
    /// The convolutions: the residual blocks' convolutions and shortcuts, the convolutions between
    /// levels, the first and the last.
    Convolution,
    /// The projections of the conditions: audio features, style, and time embedding in each
    /// residual block.
    Conditioning,
}

/// Low-rank adapters for fine-tuning (Hu et al. 2021, <https://arxiv.org/abs/2106.09685>): the
/// network's own weights are frozen; selected layers train a weight change of rank
/// [`rank`](Self::rank).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LoraConfig {
    /// Rank of each weight change.
    pub rank: usize,
    /// The weight change is scaled by `alpha / rank`.
    pub alpha: f64,
    /// Layers that get an adapter.
    pub targets: Vec<LoraTarget>,
}

impl Default for LoraConfig {
    fn default() -> Self {
        Self {
            rank: 8,
            alpha: 8.0,
            targets: vec![LoraTarget::Attention, LoraTarget::Convolution],
        }
    }
}

impl LoraConfig {
    /// # Errors
    /// Returns the first invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("lora.rank", self.rank, 1..=MAX_WIDTH).hint("4 to 16 is usual")?;
        in_range("lora.alpha", self.alpha, ABOVE_ZERO)
            .hint("`lora.rank` itself gives a scale of 1")?;
        let allowed = "one or more of `attention`, `convolution` and `conditioning`";
        require(!self.targets.is_empty(), "lora.targets", "[]", allowed)
            .hint("leave the key out for attention and convolutions")
    }
}

/// A layer whose weight can have an adapter.
pub trait Adaptable: Sized {
    /// The layer with a new adapter.
    fn with_adapter(self, config: &LoraConfig, init: &Initializer) -> Self;

    /// The layer with its adapter merged into the weight.
    fn merge_adapter(self) -> Self;
}

/// A change of a network's adapters, at one node of the module tree; [`at`](Self::at) descends.
pub enum Adapting<'a> {
    /// Adds new adapters to the layers of the config.
    Attach(&'a LoraConfig, Initializer),
    /// Merges all adapters into the weights.
    Merge,
}

impl Adapting<'_> {
    /// The change for the child `name` of this node.
    pub fn at(&self, name: &str) -> Self {
        match self {
            Self::Attach(config, init) => Self::Attach(config, init.at(name)),
            Self::Merge => Self::Merge,
        }
    }

    /// Applies the change to the child layer `name`.
    pub fn layer<L: Adaptable>(&self, target: LoraTarget, name: &str, layer: L) -> L {
        match self {
            Self::Attach(config, init) if config.targets.contains(&target) => {
                layer.with_adapter(config, &init.at(name).at("lora"))
            }
            Self::Attach(..) => layer,
            Self::Merge => layer.merge_adapter(),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde::de::IntoDeserializer;
    use serde::de::value::{Error as ValueError, MapDeserializer};

    use super::*;

    fn read(key: &'static str, value: u64) -> Result<LoraConfig, ValueError> {
        let entries = [(key, value)].into_iter();
        LoraConfig::deserialize(MapDeserializer::new(entries))
    }

    #[test]
    fn missing_keys_have_their_default_and_unknown_keys_are_refused() {
        let config = read("rank", 3).expect("a known key");
        assert_eq!(
            config,
            LoraConfig {
                rank: 3,
                ..LoraConfig::default()
            }
        );
        let error = read("r", 3).expect_err("an unknown key").to_string();
        assert!(error.contains('r') && error.contains("`rank`"), "{error}");
    }

    #[test]
    fn targets_are_written_in_snake_case() {
        let read = |name: &'static str| {
            let deserializer: serde::de::value::StrDeserializer<'_, ValueError> =
                name.into_deserializer();
            LoraTarget::deserialize(deserializer)
        };
        assert_eq!(read("attention"), Ok(LoraTarget::Attention));
        assert_eq!(read("convolution"), Ok(LoraTarget::Convolution));
        assert_eq!(read("conditioning"), Ok(LoraTarget::Conditioning));
        assert!(read("Attention").is_err());
    }

    #[test]
    fn bad_settings_are_refused_by_key() {
        let good = LoraConfig::default;
        good().validate().expect("the default");
        let refused = |config: LoraConfig, expected: &str| {
            let error = config.validate().expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        };
        refused(LoraConfig { rank: 0, ..good() }, "`lora.rank` is 0");
        for alpha in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let expected = format!("`lora.alpha` is {alpha}");
            refused(LoraConfig { alpha, ..good() }, &expected);
        }
        let targets = Vec::new();
        refused(LoraConfig { targets, ..good() }, "`lora.targets` is []");
    }
}
