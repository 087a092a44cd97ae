//! The error of a network's beat tracker in held-out music.

use std::f64::consts::TAU;

use kinegrad_motion::circular;

use crate::generate::Generator;
use crate::network::AudioCondition;
use kinegrad_data::BeatPhrase;

/// Mean distance in beats between the tracked beat phase and the music's beat phase, over the
/// frames of a phrase; `None` without a tracker.
pub(super) fn error(generator: &Generator, phrase: &BeatPhrase) -> Option<f64> {
    let audio = &phrase.phrase.audio;
    let shape = [1, audio.channels(), audio.frames()];
    let features = generator.on_device(audio.as_slice().to_vec(), shape);
    let found = generator.unet.find_beats(&AudioCondition::from(features))?;
    let found: Vec<f32> = found.into_data().try_into_vec().expect("float values");
    Some(error_of(&found, &phrase.bars, phrase.beats_per_bar))
}

/// Mean distance in beats between the angles of `found` (all sines, then all cosines) and of
/// `bars`.
fn error_of(found: &[f32], bars: &[f64], beats_per_bar: f64) -> f64 {
    let (sines, cosines) = found.split_at(bars.len());
    let found = sines.iter().zip(cosines);
    let found = found.map(|(sine, cosine)| f64::from(*sine).atan2(f64::from(*cosine)) / TAU);
    let expected = bars.iter().map(|bar| bar * beats_per_bar);
    let distances = found
        .zip(expected)
        .map(|(found, expected)| circular::distance(found, expected));
    distances.sum::<f64>() / bars.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_is_the_distance_of_the_found_phase_from_the_beat() {
        for (beats_per_bar, late) in [(3.0, 0.0), (4.0, 0.1), (3.0, -0.4), (4.0, 0.5)] {
            let bars: Vec<f64> = (0..37).map(|t| (0.83 + 0.017 * t as f64) % 1.0).collect();
            // Angles of any norm: an uncertain tracker predicts short vectors.
            let angles = bars.iter().map(|bar| TAU * (bar * beats_per_bar + late));
            let (sines, cosines): (Vec<f32>, Vec<f32>) = angles
                .map(|angle| ((0.3 * angle.sin()) as f32, (0.3 * angle.cos()) as f32))
                .unzip();
            let error = error_of(&[sines, cosines].concat(), &bars, beats_per_bar);
            assert!((error - f64::abs(late)).abs() < 1e-5, "{late}: {error}");
        }
    }
}
