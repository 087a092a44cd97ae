//! The audio conditioning tensor.
//!
//! Rows 0 to 127 mel, 128 to 139 chroma, 140 to 159 MFCC, 160 RMS, 161 spectral centroid, 162 onset
//! strength. Every row group is normalised over the whole recording.

use std::ops::Range;

use crate::mel::{self, BANDS};
use crate::{Analysis, Beats, chroma, mfcc};

/// Mel spectrogram, in [0, 1].
pub const MEL: Range<usize> = 0..BANDS;

/// Constant-Q chroma, in [0, 1], C first.
pub const CHROMA: Range<usize> = MEL.end..MEL.end + chroma::CLASSES;

/// MFCC, each row of mean 0 and deviation 1.
pub const MFCC: Range<usize> = CHROMA.end..CHROMA.end + mfcc::COEFFICIENTS;

/// Root mean square, in [0, 1].
pub const RMS: usize = MFCC.end;

/// Spectral centroid, in [0, 1].
pub const CENTROID: usize = RMS + 1;

/// Onset strength, in [0, 1].
pub const ONSET: usize = CENTROID + 1;

/// Rows of the tensor.
pub const CHANNELS: usize = ONSET + 1;

/// Avoids division by zero.
const EPSILON: f64 = 1e-8;

/// The features, tempo and beats of a recording, from [`extract`](crate::extract).
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    frames: usize,
    stacked: Vec<f32>,
    beats: Beats,
}

impl Features {
    /// Normalises and stacks the features of `analysis`.
    pub(crate) fn new(analysis: Analysis) -> Self {
        let frames = analysis.rms.len();
        drop(analysis.cqt);
        let mut stacked = Vec::with_capacity(CHANNELS * frames);
        let loudest = mel::maximum(&analysis.mel_power);
        let mel_db = mel::decibels(analysis.mel_power, loudest);
        stacked.extend(min_max(mel_db.channel_major()));
        stacked.extend(chroma::normalise(analysis.chroma).channel_major());
        for c in 0..mfcc::COEFFICIENTS {
            stacked.extend(standardise(analysis.mfcc.channel(c).collect()));
        }
        stacked.extend(by_maximum(analysis.rms));
        stacked.extend(min_max(analysis.centroid));
        stacked.extend(by_maximum(analysis.onset.mean));
        Self {
            frames,
            stacked,
            beats: analysis.beats,
        }
    }

    /// Number of frames, `T`, at least 1.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The conditioning tensor, channel-major `[163, T]`.
    pub fn stacked(&self) -> &[f32] {
        &self.stacked
    }

    /// Rows of the conditioning tensor, `[rows, T]`: `features.rows(CHROMA)`.
    ///
    /// # Panics
    /// Panics if the range exceeds [`CHANNELS`].
    pub fn rows(&self, rows: Range<usize>) -> &[f32] {
        &self.stacked[rows.start * self.frames..rows.end * self.frames]
    }

    /// The frames and beats of `range`, with the tempo of the whole recording.
    ///
    /// # Panics
    /// Panics if `range` exceeds the frames.
    pub fn slice(&self, range: Range<usize>) -> Self {
        let rows = self.stacked.chunks_exact(self.frames);
        let beats = self.beats.frames.iter();
        let inside = beats.filter(|beat| range.contains(beat));
        Self {
            frames: range.len(),
            stacked: rows.flat_map(|row| &row[range.clone()]).copied().collect(),
            beats: Beats {
                tempo: self.beats.tempo,
                frames: inside.map(|beat| beat - range.start).collect(),
            },
        }
    }

    /// Tempo and beats.
    pub fn beats(&self) -> &Beats {
        &self.beats
    }
}

/// `(x - min) / (max - min + 1e-8)`.
fn min_max(values: Vec<f32>) -> Vec<f32> {
    let min = f64::from(values.iter().copied().fold(f32::INFINITY, f32::min));
    let max = f64::from(values.iter().copied().fold(f32::NEG_INFINITY, f32::max));
    scale(values, min, max - min)
}

/// `x / (max + 1e-8)`.
fn by_maximum(values: Vec<f32>) -> Vec<f32> {
    let max = f64::from(values.iter().copied().fold(0.0, f32::max));
    scale(values, 0.0, max)
}

/// `(x - mean) / (population standard deviation + 1e-8)`.
fn standardise(values: Vec<f32>) -> Vec<f32> {
    let n = values.len().max(1) as f64;
    let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
    let squares: f64 = values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum();
    scale(values, mean, (squares / n).sqrt())
}

fn scale(mut values: Vec<f32>, offset: f64, width: f64) -> Vec<f32> {
    for value in &mut values {
        *value = ((f64::from(*value) - offset) / (width + EPSILON)) as f32;
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_rows_become_zero() {
        assert_eq!(min_max(vec![3.0, 3.0]), vec![0.0, 0.0]);
        assert_eq!(standardise(vec![-1.7e3; 7]), vec![0.0; 7]);
        assert_eq!(by_maximum(vec![0.0, 0.0]), vec![0.0, 0.0]);
    }

    #[test]
    fn a_slice_has_the_frames_and_beats_of_its_range() {
        let whole = Features {
            frames: 5,
            stacked: (0..CHANNELS * 5).map(|i| i as f32).collect(),
            beats: Beats {
                tempo: 120.0,
                frames: vec![0, 2, 3, 4],
            },
        };
        let cut = whole.slice(2..4);
        assert_eq!((cut.frames(), cut.stacked().len()), (2, 2 * CHANNELS));
        assert_eq!(cut.rows(0..1), [2.0, 3.0]);
        assert_eq!(cut.rows(ONSET..CHANNELS), [812.0, 813.0]);
        assert_eq!(cut.beats().frames, [0, 1]);
        assert_eq!(cut.beats().tempo, 120.0);
    }

    #[test]
    fn rows_add_up_to_163() {
        assert_eq!(
            (CHROMA.start, MFCC.start, RMS, CHANNELS),
            (128, 140, 160, 163)
        );
    }
}
