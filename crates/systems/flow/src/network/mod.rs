//! Networks that predict the next pose from past frames and a text.
//!
//! ```text
//! history, text, duration --> HistoryEncoder --> a context of each joint --+
//! last frame of the history ------------------------------------------------+--> FlowPredictor
//! progress, noisy pose x_t, flow time t ------------------------------------+       |
//!                                                                           velocity of x_t
//! ```
//!
//! [`FlowRollout`] samples frame by frame; each frame joins the history of the next frame.
//!
//! Source: "Human Motion Generation Architecture", sections 1 and 2, as interpreted in
//! docs/sources.md, section 5. Within this module, joints take the axis of other networks' frames:
//! `[batch, channels, joints]`.

mod config;
mod features;
mod hierarchy;
mod history;
mod predictor;
mod rollout;

#[cfg(test)]
mod tests;

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_motion::humanml::{Skeleton, TEXT_CHANNELS};
use kinegrad_settings::InvalidSetting;

pub use config::FlowConfig;
pub use features::{PREVIOUS_STATE, previous_state};
pub use hierarchy::Hierarchy;
pub use history::{History, HistoryEncoder};
pub use predictor::{FlowCondition, FlowPredictor, PreparedCondition};
pub use rollout::{FlowRollout, FlowSpace, RolloutSettings};

use kinegrad_models::Initializer;
use kinegrad_models::layers::Embedding;

/// The two networks, made by [`FlowConfig::init`]: parameters `encoder.*`, `predictor.*`, and
/// optionally `embed_captions.weight`.
#[derive(Module, Debug)]
pub struct FlowModel {
    embed_captions: Option<Embedding>,
    /// Encodes past frames and text as a context per joint.
    pub encoder: HistoryEncoder,
    /// Predicts the flow velocity of the next pose.
    pub predictor: FlowPredictor,
}

impl FlowConfig {
    /// Both networks for a skeleton.
    ///
    /// # Errors
    /// Names the invalid key.
    pub fn init(
        &self,
        skeleton: &Skeleton,
        init: &Initializer,
    ) -> Result<FlowModel, InvalidSetting> {
        self.validate()?;
        Ok(FlowModel {
            embed_captions: None,
            encoder: HistoryEncoder::new(self, skeleton.joints(), &init.at("encoder")),
            predictor: FlowPredictor::new(self, skeleton, &init.at("predictor")),
        })
    }
}

impl FlowModel {
    /// The same networks with a learned embedding per caption: `[captions, 512]`, initial variance
    /// 1.
    #[must_use]
    pub fn with_captions(self, captions: usize, init: &Initializer) -> Self {
        Self {
            embed_captions: Some(Embedding::of_captions(captions, TEXT_CHANNELS, init)),
            ..self
        }
    }

    /// The encoder's input for texts, `[batch, 512]`: `values` unchanged, or the caption embeddings
    /// for one-hot `values`, `[batch, captions]`; zeros mean no text.
    pub fn text(&self, values: Tensor<2>) -> Tensor<2> {
        match &self.embed_captions {
            Some(table) => table.mixed(values),
            None => values,
        }
    }
}
