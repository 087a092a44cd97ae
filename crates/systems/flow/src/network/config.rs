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
    /// Width inside the history encoder's perceptron, which runs per joint and frame.
    pub joint_dim: usize,
    /// Width of the perceptron's output, and of each joint's context.
    pub context_dim: usize,
    /// State of the history encoder's recurrent layer, in each direction.
    pub gru_dim: usize,
    /// Width inside the perceptron that maps the history's summary to the contexts.
    pub decoder_dim: usize,
    /// Width of the predictor's tokens; each joint has one token.
    pub latent_dim: usize,
    /// Layers of the predictor.
    pub num_layers: usize,
    /// Attention heads of the predictor.
    pub num_heads: usize,
    /// Width between each layer's two linear maps.
    pub ff_size: usize,
    /// Position of normalization in the predictor's layers: `post` or `pre`.
    pub norm: NormOrder,
    /// Also read the history backward.
    pub bidirectional: bool,
    /// Condition each joint on the joint's chain and depth in the skeleton.
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
    /// The widths of the source, with the choices in docs/sources.md, section 5. For 22 joints, the
    /// encoder has 1,639,648 parameters and the predictor 820,131.
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
    /// Names the invalid key.
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
