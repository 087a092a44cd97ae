//! Fits of the nearest coherent motion to contradicting channels.
//!
//! A phrase has redundant channels: positions, velocities and accelerations, and orientations and
//! angular velocities. A network predicts each channel with a small, independent error: positions
//! shake while accelerations are smooth. Each fit is a banded least-squares problem, linear in
//! time:
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

/// Weight of known frames relative to other frames. The fit moves known frames by a few millionths.
const KNOWN: f64 = 1e8;

fn weight(known: bool) -> f64 {
    if known { KNOWN } else { 1.0 }
}
