use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH, must_divide};
use kinegrad_models::layers::NormOrder;
use kinegrad_models::{NamedSizes, NetworkConfig};
use kinegrad_settings::{InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sizes of a [`FlowModel`](super::FlowModel).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FlowConfig {
    /// Width inside the history encoder's perceptron of each joint and frame.
    pub joint_dim: usize,
    /// Width of what the perceptron gives, and of each joint's context.
    pub context_dim: usize,
    /// State of the history encoder's recurrent layer, in each direction.
    pub gru_dim: usize,
    /// Width inside the perceptron from the history's summary to the contexts.
    pub decoder_dim: usize,
    /// Width of the predictor's tokens, one for each joint.
    pub latent_dim: usize,
    /// Layers of the predictor.
    pub num_layers: usize,
    /// Attention heads of the predictor.
    pub num_heads: usize,
    /// Width inside each layer's two linear maps.
    pub ff_size: usize,
    /// Position of normalisation in the predictor's layers: `post` or `pre`.
    pub norm: NormOrder,
    /// Read the history backwards too.
    pub bidirectional: bool,
    /// Condition each joint on its chain and its depth in the skeleton.
    pub hierarchy: bool,
    /// Condition the predictor on the remaining share of the motion.
    pub progress: bool,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self::published()
    }
}

impl NetworkConfig for FlowConfig {
    const KIND: &'static str = "flow";

    const SIZES: NamedSizes<Self> = &[("published", Self::published), ("tiny", Self::tiny)];
}

impl FlowConfig {
    /// The widths of the source, with the choices of docs/sources.md, section 5: 1,639,648
    /// parameters in the encoder and 820,131 in the predictor for 22 joints.
    pub fn published() -> Self {
        Self {
            joint_dim: 128,
            context_dim: 64,
            gru_dim: 128,
            decoder_dim: 256,
            latent_dim: 128,
            num_layers: 4,
            num_heads: 4,
            ff_size: 512,
            norm: NormOrder::Post,
            bidirectional: true,
            hierarchy: true,
            progress: true,
        }
    }

    /// For tests and first steps.
    pub fn tiny() -> Self {
        Self {
            joint_dim: 32,
            context_dim: 16,
            gru_dim: 32,
            decoder_dim: 64,
            latent_dim: 32,
            num_layers: 2,
            ff_size: 64,
            ..Self::published()
        }
    }

    /// # Errors
    /// Names the key that no network can be built from.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        for (key, width, published) in [
            ("model.joint_dim", self.joint_dim, 128),
            ("model.context_dim", self.context_dim, 64),
            ("model.gru_dim", self.gru_dim, 128),
            ("model.decoder_dim", self.decoder_dim, 256),
            ("model.latent_dim", self.latent_dim, 128),
            ("model.ff_size", self.ff_size, 512),
        ] {
            in_range(key, width, 1..=MAX_WIDTH).hint(format!("the source has {published}"))?;
        }
        must_divide(self.num_heads, self.latent_dim).hint("4 divides the source's 128")?;
        in_range("model.num_layers", self.num_layers, 1..=MAX_LAYERS).hint("the source has 4")
    }
}
