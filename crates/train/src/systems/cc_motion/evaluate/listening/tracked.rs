//! How well a network that tracks the beats itself does so in music that it was not trained on.

use std::f64::consts::TAU;

use burn::tensor::{Tensor, TensorData};
use kinegrad_models::AudioCondition;
use kinegrad_motion::circular;

use super::Listened;
use crate::systems::cc_motion::generate::Generator;

/// Mean over the frames of a phrase of the distance of the beat phase that the network's tracker
/// finds in its music from that of the music, in beats; `None` without a tracker.
pub(super) fn beat_error(generator: &Generator, listened: &Listened) -> Option<f64> {
    let audio = &listened.phrase.audio;
    let (values, frames) = (audio.as_slice(), audio.frames());
    let shape = [1, values.len() / frames, frames];
    let features = TensorData::new(values.to_vec(), shape);
    let features: Tensor<3> = Tensor::from_data(features, &generator.device);
    let found = generator
        .unet
        .track_beats(&AudioCondition::from(features))?;
    let found: Vec<f32> = found.into_data().try_into_vec().expect("float values");
    let (sine, cosine) = found.split_at(frames);
    let found = sine.iter().zip(cosine);
    let found = found.map(|(sine, cosine)| f64::from(*sine).atan2(f64::from(*cosine)) / TAU);
    let expected = listened.bars.iter().map(|bar| bar * listened.beats_per_bar);
    let distance = found
        .zip(expected)
        .map(|(found, expected)| circular::distance(found, expected));
    Some(distance.sum::<f64>() / frames as f64)
}
