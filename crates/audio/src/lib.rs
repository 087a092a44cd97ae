//! Converts a music file to the `[163, T]` audio conditioning tensor, tempo and beats.
//!
//! [`decode()`] reads a file to mono samples at [`SAMPLE_RATE`]; [`extract`] computes the features
//! at [`FPS`] frames per second, `T = 1 + floor(n / `[`HOP`]`)`. The definitions follow librosa
//! 0.11; the settings follow CC-MotionGen (section 4; docs/sources.md, section 2).
//!
//! ```
//! use kinegrad_audio::{CHANNELS, SAMPLE_RATE, extract};
//! let second: Vec<f32> = (0..SAMPLE_RATE).map(|n| (n as f32 * 0.05).sin()).collect();
//! let features = extract(&second)?;
//! assert_eq!((features.frames(), features.stacked().len()), (31, 31 * CHANNELS));
//! # Ok::<(), kinegrad_audio::Error>(())
//! ```

pub mod analysis;
pub mod beats;
pub mod chroma;
pub mod cqt;
pub mod decode;
pub mod error;
pub mod features;
pub mod frames;
pub mod guard;
pub mod mel;
pub mod mfcc;
mod mpeg;
mod octaves;
pub mod onset;
pub mod pulse;
pub mod resample;
mod riff;
pub mod rms;
mod source;
pub mod spectral;
pub mod stft;
pub mod tempo;
pub mod tuning;
mod wavelets;

pub use analysis::{Analysis, extract, extract_near};
pub use beats::Beats;
pub use decode::{Waveform, decode, decode_reader};
pub use error::{DecodeError, Error};
pub use features::{CHANNELS, Features};
pub use frames::FrameMatrix;
pub use pulse::Pulse;

/// Samples per second of every analysis.
pub const SAMPLE_RATE: u32 = 44_100;

/// Samples from one frame to the next: a thirtieth of a second.
pub const HOP: usize = 1470;

/// Frames per second of every feature.
pub const FPS: f64 = 30.0;

/// Number of frames of a signal of `samples` samples, at least 1. Frame `t` is centred on sample
/// `t * HOP`.
pub fn num_frames(samples: usize) -> usize {
    1 + samples / HOP
}
