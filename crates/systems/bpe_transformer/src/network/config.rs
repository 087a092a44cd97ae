use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH, must_be_even};
use kinegrad_models::{NamedSizes, NetworkConfig};
use kinegrad_settings::{InvalidSetting, Refused, in_range};
use kinegrad_train::clips::path_condition::PathTokens;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Channels of an attention head.
pub const HEAD_CHANNELS: usize = 64;

/// Number of leading channels of a head that rotate in relative mode.
pub const ROTATED_CHANNELS: usize = 32;

/// Largest allowed `horizon`.
const MAX_HORIZON: usize = 100_000;

/// The sizes of a [`BlendedTransformer`](super::BlendedTransformer).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BlendedConfig {
    /// Width of a token.
    pub latent_dim: usize,
    /// Number of layers; each has attention and feed-forward.
    pub num_layers: usize,
    /// Attention heads; each has 64 channels at any width.
    pub num_heads: usize,
    /// Width inside a feed-forward, rounded to a multiple of `latent_dim` as in the published
    /// program.
    pub ff_size: usize,
    /// Number of frames before and after each frame that the frame attends to, in both modes.
    pub horizon: usize,
    /// Dropout of the tokens in training, and probability of skipping a layer's attention or
    /// feed-forward (stochastic depth, Huang et al. 2016).
    pub dropout: f64,
    /// Conditions each frame on a root path (docs/sources.md, section 7, option C). Not in the
    /// published network.
    pub path: bool,
    /// Place of the path's tokens, for networks with a path.
    pub path_tokens: PathTokens,
}

impl Default for BlendedConfig {
    fn default() -> Self {
        Self::flowmdm()
    }
}

impl NetworkConfig for BlendedConfig {
    const KIND: &'static str = "bpe_transformer";

    const SIZES: NamedSizes<Self> = &[
        ("flowmdm", Self::flowmdm),
        ("flowmdm_babel", Self::flowmdm_babel),
        ("flowmdm_tiny", Self::flowmdm_tiny),
    ];
}

impl BlendedConfig {
    /// The published size for HumanML3D.
    pub fn flowmdm() -> Self {
        Self {
            latent_dim: 512,
            num_layers: 8,
            num_heads: 4,
            ff_size: 1024,
            horizon: 150,
            dropout: 0.1,
            path: false,
            path_tokens: PathTokens::Added,
        }
    }

    /// The published size for BABEL.
    pub fn flowmdm_babel() -> Self {
        Self {
            horizon: 100,
            ..Self::flowmdm()
        }
    }

    /// For tests and first steps.
    pub fn flowmdm_tiny() -> Self {
        Self {
            latent_dim: 64,
            num_layers: 2,
            num_heads: 1,
            ff_size: 128,
            horizon: 40,
            ..Self::flowmdm()
        }
    }

    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        must_be_even(self.latent_dim, "the published model has 512")?;
        in_range("model.num_layers", self.num_layers, 1..=MAX_LAYERS)
            .hint("the published model has 8")?;
        let most = MAX_WIDTH / HEAD_CHANNELS;
        in_range("model.num_heads", self.num_heads, 1..=most)
            .hint("the published model has 4, of 64 channels each")?;
        in_range("model.ff_size", self.ff_size, 1..=MAX_WIDTH)
            .hint("the published model has 1024")?;
        in_range("model.horizon", self.horizon, 1..=MAX_HORIZON)
            .hint("150 frames in the published model of HumanML3D, 100 in that of BABEL")?;
        in_range("model.dropout", self.dropout, 0.0..1.0)
            .hint("0.1 in the published training; 0 for none")
    }

    /// True if the condition has the channels of a path.
    pub(super) fn concatenates_path(&self) -> bool {
        self.path && self.path_tokens == PathTokens::Concatenated
    }

    /// Width inside a feed-forward: `ff_size` rounded to a multiple of the width, with ties to
    /// even.
    pub(super) fn inner_width(&self) -> usize {
        let times = (self.ff_size as f64 / self.latent_dim as f64).round_ties_even();
        self.latent_dim * (times as usize).max(1)
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        let heads = self.num_heads * HEAD_CHANNELS;
        let layer = 8 * self.latent_dim + 8 * heads + 2 * self.inner_width();
        let tokens = match self.path && self.path_tokens == PathTokens::Rows {
            true => 2 * frames,
            false => frames,
        };
        tokens as u64 * self.num_layers as u64 * layer as u64
    }
}
