//! How a set of phrases compares with others: variety, distance to real motion, agreement with
//! the music.
//!
//! Variety and distance look at the trajectory of the root, [`TRAJECTORY`], in units of the
//! training phrases' standard deviations. A metric that cannot be computed, for want of phrases
//! or because a value is not finite, is `None`.

mod beats;
mod diversity;
mod frechet;

pub use beats::{BEAT_SIGMA, beat_alignment, kinematic_beats};
pub use diversity::{diversity, trajectory_distance};
pub use frechet::{FeatureMoments, frechet_distance, trajectory_features};

use std::ops::Range;

/// The channels that variety and distance look at: position, velocity and acceleration.
pub const TRAJECTORY: Range<usize> = 0..9;
