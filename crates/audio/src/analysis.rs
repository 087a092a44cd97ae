//! Intermediate tensors between the samples and the features.

use crate::onset::{self, OnsetStrength};
use crate::{
    Beats, Error, Features, FrameMatrix, beats, chroma, cqt, mel, mfcc, num_frames, rms, spectral,
    tuning,
};

/// Largest magnitude of a sample, whose power must fit single precision. Full scale is 1.
pub const LARGEST_SAMPLE: f32 = 1e6;

/// The features of a recording before normalisation.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Mel power between 20 and 8000 Hz, `[T, 128]`.
    pub mel_power: FrameMatrix,
    /// Mel spectrogram between 0 and 22050 Hz in decibels relative to 1, `[T, 128]`.
    pub mel_full_db: FrameMatrix,
    /// Mel-frequency cepstral coefficients, `[T, 20]`.
    pub mfcc: FrameMatrix,
    /// Deviation from concert pitch in fractions of a 1/36-octave bin.
    pub tuning: f64,
    /// Magnitude of the constant-Q transform, `[T, 252]`.
    pub cqt: FrameMatrix,
    /// Constant-Q magnitude of each pitch class, `[T, 12]`.
    pub chroma: FrameMatrix,
    /// Root mean square, `[T]`.
    pub rms: Vec<f32>,
    /// Spectral centroid in Hz, `[T]`.
    pub centroid: Vec<f32>,
    /// Onset strength, mean and median over the bands.
    pub onset: OnsetStrength,
    /// Tempo and beats.
    pub beats: Beats,
}

impl Analysis {
    /// Analyses any number of mono samples at [`SAMPLE_RATE`](crate::SAMPLE_RATE).
    ///
    /// # Errors
    /// [`Error::Sample`] for a sample that is not finite or beyond [`LARGEST_SAMPLE`];
    /// [`Error::AnalysisMemory`] if memory is full.
    pub fn new(signal: &[f32]) -> Result<Self, Error> {
        check(signal)?;
        Ok(Self::of_checked(signal, tuning::estimate(signal)))
    }

    /// [`new`](Self::new) with a known deviation from concert pitch.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_tuning(signal: &[f32], tuning: f64) -> Result<Self, Error> {
        check(signal)?;
        Ok(Self::of_checked(signal, tuning))
    }

    fn of_checked(signal: &[f32], tuning: f64) -> Self {
        let spectral = spectral::analyse(signal);
        let mel_full_db = mel::decibels(spectral.mel_full_power, 1.0);
        let cqt = cqt::magnitudes(signal, tuning);
        let onset = onset::strength(&mel_full_db);
        Self {
            mel_power: spectral.mel_power,
            mfcc: mfcc::coefficients(&mel_full_db),
            mel_full_db,
            tuning,
            chroma: chroma::fold(&cqt),
            cqt,
            rms: rms::root_mean_square(signal),
            centroid: spectral.centroid,
            beats: beats::track(&onset.median),
            onset,
        }
    }

    /// Normalises and stacks the features.
    pub fn features(self) -> Features {
        Features::new(self)
    }

    /// Approximate bytes of memory for the features of `samples` samples, without the samples.
    pub fn memory(samples: usize) -> u64 {
        // All tensors of an analysis, inputs of the same size, and one piece of the band-limited
        // samples.
        let per_frame = 2 * mel::BANDS + mfcc::COEFFICIENTS + cqt::BINS + chroma::CLASSES + 4;
        let growing = num_frames(samples) as u64 * per_frame as u64 * 8;
        let piece = samples.min(cqt::SAMPLES_AT_A_TIME) as u64 * 8;
        growing + piece + (16 << 20)
    }
}

/// The features of any number of mono samples at [`SAMPLE_RATE`](crate::SAMPLE_RATE).
///
/// # Errors
/// As [`Analysis::new`].
pub fn extract(signal: &[f32]) -> Result<Features, Error> {
    Ok(Analysis::new(signal)?.features())
}

/// [`extract`] with beats tracked near a tempo of `bpm` beats per minute.
///
/// # Errors
/// As [`Analysis::new`].
pub fn extract_near(signal: &[f32], bpm: f64) -> Result<Features, Error> {
    let analysis = Analysis::new(signal)?;
    let beats = beats::track_near(&analysis.onset.median, bpm);
    Ok(Analysis { beats, ..analysis }.features())
}

fn check(signal: &[f32]) -> Result<(), Error> {
    if let Some(index) = unusable_sample(signal) {
        return Err(Error::Sample {
            index,
            found: signal[index],
        });
    }
    // Later allocations cannot report failure.
    let needed = Analysis::memory(signal.len());
    let room = usize::try_from(needed).map(|needed| Vec::<u8>::new().try_reserve_exact(needed));
    match room {
        Ok(Ok(())) => Ok(()),
        _ => Err(Error::AnalysisMemory {
            minutes: signal.len() as f64 / f64::from(crate::SAMPLE_RATE) / 60.0,
            mebibytes: needed >> 20,
        }),
    }
}

/// Position of the first sample that is not finite or beyond [`LARGEST_SAMPLE`].
pub(crate) fn unusable_sample(signal: &[f32]) -> Option<usize> {
    signal
        .iter()
        .position(|y| !y.is_finite() || y.abs() > LARGEST_SAMPLE)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{CHANNELS, num_frames};

    #[test]
    fn bad_samples_are_named() {
        for bad in [f32::NAN, f32::INFINITY, 1e7] {
            let found = extract(&[0.0, 0.5, bad]);
            assert!(matches!(found, Err(Error::Sample { index: 2, .. })));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn every_length_has_finite_features(len in 0usize..4000, level in 0f32..1e6, seed: u32) {
            let mut state = seed | 1;
            let noise: Vec<f32> = (0..len)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state as f32 / u32::MAX as f32 * 2.0 - 1.0) * level
                })
                .collect();
            let features = extract(&noise)?;
            prop_assert_eq!(features.frames(), num_frames(len));
            prop_assert_eq!(features.stacked().len(), CHANNELS * num_frames(len));
            prop_assert!(features.stacked().iter().all(|v| v.is_finite()));
        }
    }
}
