//! The nearest motion that agrees with itself, to one whose channels contradict each other.
//!
//! A phrase says how it moves more than once: by its positions, velocities and accelerations, and
//! by its orientations and angular velocities. A network that predicts all of them is wrong about
//! each a little and independently from frame to frame, so that its positions shake while its
//! accelerations are calm. Each fit here is a least-squares problem over all frames, with few
//! diagonals, solved in time and memory proportional to the frames:
//!
//! - [`fit_trajectory`]: positions to positions, velocities and accelerations
//! - [`fit_heading`]: headings to orientations, each as far as it is sure, and angular velocities
//! - [`fit_orientation`]: orientations to quaternions and angular velocities
//! - [`fit_phase`]: a phase that advances steadily
//!
//! That a fitted motion is coherent is true by construction and says nothing of the network.

mod heading;
mod orientation;
mod phase;
mod trajectory;

pub use heading::{UPRIGHT, fit_heading, heading_confidence};
pub use orientation::{OrientationFit, fit_orientation};
pub use phase::fit_phase;
pub use trajectory::{CoherentFit, EXTRA_FRAMES, coherent_matrix, fit_trajectory};

/// Weight of what is said of a frame that is known, where others have 1: tension between frames
/// moves it by a few millionths.
const KNOWN: f64 = 1e8;

fn weight(known: bool) -> f64 {
    if known { KNOWN } else { 1.0 }
}
