//! Motion that goes on: from past frames and a text to the next pose.
//!
//! ```text
//! history, text, duration --> HistoryEncoder --> a context of each joint --+
//! last frame of the history ------------------------------------------------+--> FlowPredictor
//! progress, noisy pose x_t, flow time t ------------------------------------+       |
//!                                                                           velocity of x_t
//! ```
//!
//! [`FlowRollout`] draws frame after frame, each the history of the next.
//!
//! Source: the document "Human Motion Generation Architecture", sections 1 and 2, as
//! docs/sources.md reads it, section 5. Within this module joints stand where other networks have
//! frames: `[batch, channels, joints]`.

mod config;
mod features;
mod hierarchy;
mod history;
mod predictor;
mod rollout;

#[cfg(test)]
mod tests;

use burn::module::Module;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_settings::InvalidSetting;

pub use config::FlowConfig;
pub use features::{PREVIOUS_STATE, previous_state};
pub use hierarchy::Hierarchy;
pub use history::{History, HistoryEncoder};
pub use predictor::{FlowCondition, FlowPredictor};
pub use rollout::{FlowRollout, FlowSpace, RolloutError, RolloutSettings};

use crate::Initializer;

/// The two networks: parameters `encoder.*` and `predictor.*`. Should be created with
/// [`FlowConfig::init`].
#[derive(Module, Debug)]
pub struct FlowModel {
    /// Past frames and text to a context of each joint.
    pub encoder: HistoryEncoder,
    /// The velocity of the next pose.
    pub predictor: FlowPredictor,
}

impl FlowConfig {
    /// Both networks for a skeleton; their parameters are drawn when they are first used.
    ///
    /// # Errors
    /// Names the key that no network can be built from.
    pub fn init(
        &self,
        skeleton: &Skeleton,
        init: &Initializer,
    ) -> Result<FlowModel, InvalidSetting> {
        self.validate()?;
        Ok(FlowModel {
            encoder: HistoryEncoder::new(self, skeleton.joints(), &init.at("encoder")),
            predictor: FlowPredictor::new(self, skeleton, &init.at("predictor")),
        })
    }
}
