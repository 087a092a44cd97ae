//! Motion capture: from capture files to datasets of phrases and of clips.
//!
//! A capture file ([`Bvh`], [`C3d`]) becomes a [`RootSource`]: place and orientation of the pelvis
//! over time. [`assemble`] aligns [`Segment`]s with the music and [`join`] removes the jumps between
//! them; [`resample`] is for takes without segments. The track at 30 frames per second, with its
//! musical phase ([`Beats`]), gives phrases ([`stretches`], [`Stretch::phrases`]). [`phrases`] and
//! [`clips`] write the dataset of a [`Plan`]. The parsers never panic and allocate no more than a
//! small multiple of their input.
//!
//! ```
//! use kinegrad_capture::{BeatGrid, Beats, Bvh, UpAxis, resample, stretches};
//! use kinegrad_motion::{FPS, Profile, check};
//! let mut text = "HIERARCHY\nROOT Hips\n{ OFFSET 0 0 0\n\
//!                 CHANNELS 4 Xposition Yposition Zposition Yrotation }\n\
//!                 MOTION\nFrames: 241\nFrame Time: 0.0166667\n".to_string();
//! for t in 0..241 {
//!     text += &format!("{} 90 {} {t}\n", 0.1 * t as f64, 0.2 * t as f64);
//! }
//! let take = Bvh::parse(text.as_bytes(), "walk.bvh")?.root_track(0.01, UpAxis::Y)?;
//! let track = resample(&take, FPS)?;
//! let beats = Beats::Grid(BeatGrid {
//!     start_seconds: 0.0,
//!     seconds_per_beat: 0.5,
//!     beats_per_bar: 4,
//!     beats: None,
//! });
//! let phase = beats.phase(track.positions.len(), FPS)?;
//! let phrases = stretches(&track, &phase)?[0].phrases(0, 60, 30)?;
//! assert_eq!(phrases.len(), 3);
//! for (_, phrase) in &phrases {
//!     assert!(check(phrase, Profile::Ccmotion, None).passed);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod assemble;
mod bvh;
mod c3d;
pub mod clips;
mod error;
mod join;
mod markers;
mod phase;
pub mod phrases;
pub mod plan;
pub mod prepare;
mod stretches;
mod track;
mod up_axis;

pub use assemble::{Assembly, Moment, Segment, assemble};
pub use bvh::{Axis, Bvh, Channel, Deviation, Joint, bare_name};
pub use c3d::{C3d, Processor};
pub use error::Error;
pub use join::{Joining, join};
pub use markers::{MarkerMap, MarkerRoot};
pub use phase::{BeatGrid, Beats, TrackedBeats};
pub use plan::{Plan, Units};
pub use stretches::{Stretch, stretches};
pub use track::{MarkerGaps, RootPose, RootSource, RootTrack, resample};
pub use up_axis::UpAxis;
