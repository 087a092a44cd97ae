//! Metrics of sets of phrases: variety, distance from real motion, agreement with the music.
//!
//! Variety and distance use the root's [`TRAJECTORY`] in training standard deviations. A metric
//! without data or with values that are not finite is `None`. [`GoalReport`] has metrics of goals,
//! [`text_motion`] of motions and captions.

mod beats;
mod body_quality;
mod bootstrap;
mod diversity;
mod frechet;
mod goal;
mod ground;
mod joints;
mod phase;
pub mod text_motion;
mod transitions;
mod variety;

pub use beats::{BEAT_SIGMA, beat_alignment, chance_alignment, kinematic_beats, speed_peaks};
pub use body_quality::{BodyQuality, FLOATING};
pub use bootstrap::Estimate;
pub use diversity::{diversity, feature_diversity, trajectory_distance};
pub use frechet::{FeatureMoments, frechet_distance, trajectory_features};
pub use goal::{GoalReport, GoalSample, keyframe_distances};
pub use ground::{Clearance, PathStep, clearance, fastest_step, step_speeds};
pub use joints::{
    SKATING_HEIGHT, SKATING_SPEED, SkatingStep, jerk_norms, lowest_heights, mean_jerk,
    skating_ratio, skating_steps, sliding_ratio,
};
pub use phase::phase_error;
pub use transitions::{BABEL_JERK, HUMANML3D_JERK, TransitionJerk, jerk_of_frames};
pub use variety::{mean_pair_distance, multimodality, replication_interval, trajectory_diversity};

use std::ops::Range;

/// The mean; `None` without values, or if a value is missing or not finite.
pub fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values: Vec<f64> = values.collect::<Option<_>>()?;
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    mean.is_finite().then_some(mean)
}

/// The channels of variety and distance: position, velocity and acceleration.
pub const TRAJECTORY: Range<usize> = 0..9;
