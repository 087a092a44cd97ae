//! New motion from one or a few examples, without training: GenMM, generative motion matching.
//!
//! Patches are short pieces of the examples. They are matched with a coarse start of noise, from
//! coarse to fine, and averaged where they overlap. Source: W. Li and others, Example-based Motion
//! Synthesis via Generative Motion Matching (2023), and its published program;
//! docs/sources/genmm.md.
//!
//! ```
//! use kinegrad_matching::{Frames, Preset, Request, Settings, synthesize};
//! let wave = (0..120).map(|t| (0.2 * t as f32).sin());
//! let example = Frames::new(1, wave.collect());
//! let request = Request {
//!     examples: &[example],
//!     frames: 200,
//!     settings: &Settings::of(Preset::Published),
//!     groups: &[],
//!     constraints: &[],
//! };
//! let new = synthesize(&request, 0)?;
//! assert_eq!(new.frames.frames(), 200);
//! # Ok::<(), kinegrad_settings::InvalidSetting>(())
//! ```

mod common_joints;
mod constraint;
mod continuity;
mod diagonals;
mod displacement;
mod distance;
mod error;
mod figures;
mod foot_locking;
mod frames;
mod job;
mod keyframes;
mod length;
mod limit_jerk;
mod made;
mod metrics;
mod motion_matrix;
mod nearest;
mod parts;
mod pool;
mod pyramid;
pub mod rotation6d;
mod settings;
mod smoothing;
mod synthesis;
mod vote;

pub use common_joints::{CommonJoints, JointNames};
pub use constraint::Constraint;
pub use displacement::{displacements, places};
pub use error::Error;
pub use figures::{joined, separated};
pub use frames::Frames;
pub use job::{Adaptation, Fixed, Heading, Job, PartChoice};
pub use keyframes::Keyframe;
pub use kinegrad_capture::Axis;
pub use length::Length;
pub use limit_jerk::{jerk_around, jerks, percentile_95};
pub use made::Made;
pub use metrics::{Measures, Movement, Novelty, Quality, Run, Seam, Sliding};
pub use motion_matrix::{Example, MatrixOptions, MotionMatrix};
pub use nearest::{Distance, Matches, Search};
pub use parts::{Part, feet};
pub use pool::Pool;
pub use pyramid::{Levels, pyramid_lengths};
pub use settings::{CoarseRatio, Looping, Preset, Settings, Start};
pub use synthesis::{
    Channels, Request, Synthesis, start, start_noise, step, synthesize, synthesize_from,
    synthesize_like,
};
pub use vote::{pad_loop, unpad_loop, vote, vote_loop};
