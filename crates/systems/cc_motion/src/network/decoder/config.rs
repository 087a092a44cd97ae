//! The table `decoder` of a training config.

use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH};
use kinegrad_motion::{CHANNELS, ChannelEncoding, OrientationEncoding, PhaseEncoding};
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The bound of one component of the decoded motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutputActivation {
    /// Nothing.
    #[default]
    None,
    /// `range tanh(y)`: the component's entry of `output_ranges` is the range.
    TanhScaled,
    /// `1 / (1 + exp(-y))`.
    Sigmoid,
    /// Division by the Euclidean norm over the component's channels.
    Normalize,
}

/// One activation per component. CC-MotionGen's configuration and code disagree (sections 3.3.1 and
/// 3.3.2; docs/sources.md, section 1.6); the defaults are the code's activations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OutputActivations {
    /// Meters.
    pub position: OutputActivation,
    /// Meters per second.
    pub velocity: OutputActivation,
    /// Meters per second squared.
    pub acceleration: OutputActivation,
    /// Unit norm.
    pub quaternion: OutputActivation,
    /// Radians per second.
    pub angular_velocity: OutputActivation,
    /// 0 to 1.
    pub phase: OutputActivation,
    /// Unbounded.
    pub style: OutputActivation,
}

impl OutputActivations {
    /// The activations of heads that predict `targets`. Sine and cosine, and the inputs of the
    /// conversion to a unit quaternion, are not bounded.
    pub(super) fn of(self, targets: ChannelEncoding) -> Self {
        let mut own = self;
        if targets.phase != PhaseEncoding::Scalar {
            own.phase = OutputActivation::None;
        }
        if targets.orientation != OrientationEncoding::Quaternion {
            own.quaternion = OutputActivation::None;
        }
        own
    }
}

impl Default for OutputActivations {
    fn default() -> Self {
        use OutputActivation::{None, Normalize, Sigmoid, TanhScaled};
        Self {
            position: None,
            velocity: TanhScaled,
            acceleration: None,
            quaternion: Normalize,
            angular_velocity: None,
            phase: Sigmoid,
            style: None,
        }
    }
}

/// The ranges of `tanh_scaled`, in each component's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OutputRanges {
    /// Meters.
    pub position: f64,
    /// Meters per second.
    pub velocity: f64,
    /// Meters per second squared.
    pub acceleration: f64,
    /// Radians per second.
    pub angular_velocity: f64,
    /// The dataset's units.
    pub style: f64,
}

impl Default for OutputRanges {
    fn default() -> Self {
        Self {
            position: 100.0,
            velocity: 20.0,
            acceleration: 100.0,
            angular_velocity: 10.0,
            style: 10.0,
        }
    }
}

/// Consistency of position, velocity and acceleration of the decoded motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Coherence {
    /// Unchanged outputs of the heads; only the losses make the outputs consistent (CC-MotionGen's
    /// decoder).
    #[default]
    None,
    /// Position, velocity and acceleration are replaced by the nearest trajectory in the
    /// least-squares sense. The quaternion keeps its sign from frame to frame. The angular velocity
    /// is the derivative of the quaternions.
    Projection,
    /// Like `projection`; in addition, before the derivative is taken, headings and then
    /// orientations are fitted by least squares to themselves and to the head's angular velocities.
    Full,
}

/// The activation inside a decoder's residual blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecoderActivation {
    /// Exact GELU.
    #[default]
    Gelu,
    /// ReLU.
    Relu,
    /// SiLU.
    Silu,
}

/// Initial weights of a decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecoderInit {
    /// The inverse of the normalization, as near as the output activations allow.
    #[default]
    Identity,
    /// Uniform, as in PyTorch's layers.
    Random,
}

/// The table `decoder`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DecoderConfig {
    /// Width of the residual stream.
    pub hidden_dim: usize,
    /// Residual blocks.
    pub num_layers: usize,
    /// Dropout inside the residual blocks.
    pub dropout: f64,
    /// LayerNorm at the start of each residual block; otherwise BatchNorm over all frames of a
    /// batch, padding included, with running statistics of momentum 0.1 outside training.
    /// BatchNorm needs batches of two or more frames and one rank.
    pub use_layer_norm: bool,
    /// The activation inside the residual blocks.
    pub activation: DecoderActivation,
    /// The bound of each component.
    pub output_activations: OutputActivations,
    /// The bounds of `tanh_scaled`.
    pub output_ranges: OutputRanges,
    /// Consistency of position, velocity and acceleration.
    pub coherence: Coherence,
    /// Initial weights.
    pub init: DecoderInit,
}

impl Default for DecoderConfig {
    fn default() -> Self {
        Self {
            hidden_dim: 256,
            num_layers: 3,
            dropout: 0.1,
            use_layer_norm: true,
            activation: DecoderActivation::default(),
            output_activations: OutputActivations::default(),
            output_ranges: OutputRanges::default(),
            coherence: Coherence::default(),
            init: DecoderInit::default(),
        }
    }
}

impl DecoderConfig {
    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let least = match self.init {
            DecoderInit::Identity => CHANNELS,
            DecoderInit::Random => 1,
        };
        in_range("decoder.hidden_dim", self.hidden_dim, least..=MAX_WIDTH)
            .hint("CC-MotionGen has 256; `decoder.init = \"random\"` allows fewer than 25")?;
        in_range("decoder.num_layers", self.num_layers, 0..=MAX_LAYERS)
            .hint("CC-MotionGen has 3")?;
        in_range("decoder.dropout", self.dropout, 0.0..1.0).hint("CC-MotionGen has 0.1")?;
        let ranges = &self.output_ranges;
        for (component, range) in [
            ("position", ranges.position),
            ("velocity", ranges.velocity),
            ("acceleration", ranges.acceleration),
            ("angular_velocity", ranges.angular_velocity),
            ("style", ranges.style),
        ] {
            in_range(component, range, ABOVE_ZERO)
                .within("decoder.output_ranges")
                .hint("a velocity of 20 m/s is CC-MotionGen's")?;
        }
        Ok(())
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        // Inside, a block is four times as wide.
        let a_frame = (16 * self.num_layers as u64 + 2) * self.hidden_dim as u64;
        frames as u64 * (a_frame + 8 * CHANNELS as u64)
    }

    /// Number of values computed once for motion of `frames` frames, for any number of items: the
    /// banded systems of the coherent fits, and their solutions.
    pub fn shared(&self, frames: usize) -> u64 {
        let axes = match self.coherence {
            Coherence::None => 0,
            Coherence::Projection => 3,
            Coherence::Full => 4,
        };
        // In double precision.
        axes * 2 * 16 * frames as u64
    }
}
