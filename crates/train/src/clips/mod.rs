//! Runs on clips of joint features beyond their training: networks from checkpoints, motion led to
//! goals, published weights.

mod generator;
mod import;
mod model;
pub(crate) mod published;
mod space;

pub use generator::{ClipGenerator, ClipRequest, ClipSample, Stage, read_goal};
pub use import::{Architecture, ImportRequest, import};
pub use model::{TrainedClips, clip_channels, model_in_space, text_denoiser};
pub use space::{FeatureSpace, GroundGoal};

pub(crate) use model::ClipStart;
