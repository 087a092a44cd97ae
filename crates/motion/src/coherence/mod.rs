//! Fits of the nearest coherent motion to channels that contradict each other.
//!
//! A phrase states its movement by positions, velocities and accelerations, and by orientations and
//! angular velocities. A network predicts each with a small, independent error: positions shake
//! while accelerations are smooth. Each fit is a banded least-squares problem, linear in time:
//!
//! - [`fit_trajectory`]: positions to positions, velocities and accelerations
//! - [`fit_heading`]: headings to orientations, weighted by confidence, and angular velocities
//! - [`fit_orientation`]: orientations to quaternions and angular velocities
//! - [`fit_phase`]: a phase that advances evenly
//!
//! A fitted motion is coherent by construction, so its coherence does not measure the network.

mod heading;
mod orientation;
mod phase;
mod trajectory;

pub use heading::{UPRIGHT, fit_heading, heading_confidence};
pub use orientation::{OrientationFit, fit_orientation};
pub use phase::fit_phase;
pub use trajectory::{CoherentFit, EXTRA_FRAMES, coherent_matrix, fit_trajectory};

/// Weight of known frames; others have 1. They move by a few millionths.
const KNOWN: f64 = 1e8;

fn weight(known: bool) -> f64 {
    if known { KNOWN } else { 1.0 }
}
