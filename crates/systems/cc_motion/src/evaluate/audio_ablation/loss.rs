//! The validation loss at high noise.

use burn::tensor::{Tensor, TensorData};
use kinegrad_data::{AUDIO, AudioFeatures, PhraseItem};
use kinegrad_random::{Key, Purpose};
use kinegrad_train::denoising::{Conditions, Inputs, RandomInputs};

use crate::generate::Generator;
use crate::recipes::denoising_loss;

/// Number of noise levels per phrase.
const LEVELS: usize = 8;

/// The timesteps of high noise, evenly spaced in the upper half of `num_train_timesteps`, in which
/// the network depends most on its condition.
pub(super) fn high_noise(num_train_timesteps: usize) -> Vec<usize> {
    let lowest = num_train_timesteps / 2;
    let width = num_train_timesteps - lowest;
    (0..LEVELS)
        .map(|level| lowest + (2 * level + 1) * width / (2 * LEVELS))
        .collect()
}

/// The validation loss of a phrase's motion conditioned on `audio` of equal length: unweighted,
/// with tracked beats, mean over the levels of [`high_noise`]. Noise depends only on the phrase's
/// id and the level, so losses of one phrase differ only by the audio.
pub(super) fn loss(generator: &Generator, phrase: &PhraseItem, audio: &AudioFeatures) -> f64 {
    let device = &generator.device;
    let timesteps = high_noise(generator.diffusion.config.num_train_timesteps);
    let (levels, frames) = (timesteps.len(), phrase.frames());
    let batch = |values: Vec<f32>| -> Tensor<3> {
        let channels = values.len() / (levels * frames);
        Tensor::from_data(TensorData::new(values, [levels, channels, frames]), device)
    };
    let targets = generator.targets.encode(phrase.motion.as_slice());
    let x_start = generator.state.normalization().normalize(&targets);
    let key = Key::new(0, Purpose::Validation).named(&phrase.id);
    let noise = (0..levels).flat_map(|level| key.at(level as u64).normals(x_start.len()));
    let noise = batch(noise.collect());
    let inputs = Inputs {
        x_start: batch(x_start.repeat(levels)),
        cond: Conditions::new([(AUDIO, batch(audio.as_slice().repeat(levels)))]),
        mask: Tensor::ones([levels, frames], device),
        lengths: None,
    };
    let draws = RandomInputs {
        timesteps,
        noise,
        condition_dropout_mask: None,
        style_dropout_mask: None,
        dropout: None,
    };
    let loss = denoising_loss(&generator.diffusion, &generator.unet, inputs, draws, false);
    f64::from(loss.total.into_scalar::<f32>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_lie_in_the_upper_half_and_cover_it() {
        let levels = high_noise(1000);
        assert_eq!((levels.len(), levels[0], levels[7]), (LEVELS, 531, 968));
        assert!(levels.windows(2).all(|pair| pair[0] < pair[1]));
        for few in [1, 2, 5] {
            let levels = high_noise(few);
            assert!(
                levels.iter().all(|&t| t < few && t >= few / 2),
                "{levels:?}"
            );
        }
    }
}
