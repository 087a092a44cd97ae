//! The widths that a config chooses.

use kinegrad_models::config::MAX_WIDTH;
use kinegrad_models::{NamedSizes, NetworkConfig};
use kinegrad_settings::{InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const MAX_EMBEDDING: usize = 4096;

/// Widths of a text-motion evaluator that is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TextMotionSizes {
    /// Channels between the two convolutions over frames.
    pub convolution: usize,
    /// Numbers of a movement, one for every four frames.
    pub movement: usize,
    /// State of the motion encoder's GRU.
    pub motion_state: usize,
    /// State of the text encoder's GRU.
    pub text_state: usize,
    /// Numbers of an embedding.
    pub embedding: usize,
}

impl Default for TextMotionSizes {
    fn default() -> Self {
        Self::published()
    }
}

impl NetworkConfig for TextMotionSizes {
    const KIND: &'static str = "text_motion";

    const SIZES: NamedSizes<Self> = &[
        ("text_motion", Self::published),
        ("text_motion_tiny", Self::tiny),
    ];
}

impl TextMotionSizes {
    /// The sizes of the published evaluator for HumanML3D.
    pub fn published() -> Self {
        Self {
            convolution: 512,
            movement: 512,
            motion_state: 1024,
            text_state: 512,
            embedding: 512,
        }
    }

    /// For few captions, on a CPU.
    pub fn tiny() -> Self {
        Self {
            convolution: 96,
            movement: 64,
            motion_state: 64,
            text_state: 32,
            embedding: 32,
        }
    }

    /// # Errors
    /// Names the key that no network can be built from.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        for (key, width) in [
            ("model.convolution", self.convolution),
            ("model.movement", self.movement),
            ("model.motion_state", self.motion_state),
            ("model.text_state", self.text_state),
        ] {
            in_range(key, width, 1..=MAX_WIDTH)?;
        }
        in_range("model.embedding", self.embedding, 1..=MAX_EMBEDDING)
            .hint("evaluations have a covariance of so many rows and columns")
    }
}
