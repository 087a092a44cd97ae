//! Representations of motion on the host: the 25-channel phrase, joint features as in HumanML3D
//! ([`humanml`]), rotations, statistics, augmentation, post-processing, checks and metrics.
//!
//! The crate has no tensors with gradients and no file I/O. Units are metres and seconds,
//! right-handed, +y up. A phrase has [`FPS`] frames per second. Source: CC-MotionGen, sections 2, 9
//! and 10 (docs/sources.md, sections 1.1, 1.12 and 1.13).
//!
//! ```
//! use kinegrad_motion::{Phrase, PostProcessConfig, Profile, check, process};
//! let mut frame = [0.0f32; 25];
//! frame[9] = 2.0; // a quaternion of twice the unit norm
//! let motion = Phrase::new(frame.repeat(4))?;
//! assert!(!check(&motion, Profile::Ccmotion, None).passed);
//! let repaired = process(&motion, &PostProcessConfig::default(), None);
//! assert!(check(&repaired, Profile::Ccmotion, None).passed);
//! # Ok::<(), kinegrad_motion::Error>(())
//! ```

pub mod augment;
pub mod banded;
pub mod body_measures;
pub mod channel_encoding;
pub mod circular;
pub mod coherence;
pub mod derivatives;
pub mod emphasis;
pub mod error;
pub mod feet;
pub mod goal;
pub mod heading_alignment;
pub mod humanml;
pub mod metrics;
pub mod moments;
pub mod motion_measures;
pub mod path;
pub mod phrase;
pub mod postprocess;
pub mod quantiles;
pub mod representation;
pub mod rotation;
pub mod sanity;
pub mod statistics;
pub mod stitch;
pub mod style;
pub mod time_stretch;
pub mod vector;

#[cfg(test)]
mod random_phrase;

pub use augment::{anchor_floor, mirror, rotate_yaw};
pub use body_measures::{BodyMeasure, BodyValue};
pub use channel_encoding::{ChannelEncoding, OrientationEncoding, PhaseEncoding};
pub use derivatives::derive;
pub use error::Error;
pub use moments::ChannelMoments;
pub use motion_measures::MotionMeasure;
pub use phrase::{CHANNELS, FPS, Phrase, channel_name};
pub use postprocess::{
    ClampLimits, Differences, Hemisphere, PostProcessConfig, PostProcessProfile, process,
    process_around,
};
pub use representation::{
    Curves, GroundPath, JointFeatures, JointPositions, Measured, Phrases, Representation,
    phrase_statistics,
};
pub use rotation::Quaternion;
pub use sanity::{
    BodyFinding, CapturedBody, Check, Profile, Report, SanityThresholds, Threshold, Value, check,
    check_capture, check_thresholds,
};
pub use statistics::Statistics;

/// Largest number of frames of a motion or song: two hours at 30 frames per second.
pub const MAX_FRAMES: usize = 216_000;
