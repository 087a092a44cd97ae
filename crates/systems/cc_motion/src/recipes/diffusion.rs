//! Training of the denoiser (CC-MotionGen, sections 5.3 and 6.2; docs/sources.md, section 1.4):
//!
//! ```text
//! L = w(t) E |target - f(x_t, t, cond)|     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
//! ```
//!
//! `t` is uniform over the timesteps. `diffusion.prediction_type` selects the target,
//! `diffusion.loss_type` the distance. Zeros replace the condition with probability
//! `diffusion.cond_drop_prob`, and a style with probability `diffusion.style_drop_prob`, which
//! trains the null conditions of classifier-free guidance.
//!
//! If the network tracks beats (`model.beats`), the loss adds the tracker's squared error over
//! frames with beat labels. The tracker has no other loss. The rest of the network is trained with
//! the labels (teacher forcing) and sampled with the tracker's beats.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{GaussianDiffusion, diffusion_loss};
use kinegrad_train::Loss;
use kinegrad_train::denoising::{DenoisingRecipe, HeldOut, Inputs, RandomInputs};

use crate::network::{AudioCondition, UNet1d, beat_labels};
use crate::style::condition;

/// Trains a [`UNet1d`] to denoise with the process `diffusion`, validated on `held_out`.
pub fn diffusion_recipe(
    diffusion: GaussianDiffusion,
    held_out: HeldOut,
) -> DenoisingRecipe<UNet1d> {
    DenoisingRecipe::new(diffusion, held_out, denoising_loss)
}

/// The denoising loss; with `training`, including weights w(t), the tracker's loss and teacher
/// forcing.
pub(in super::super) fn denoising_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    inputs: Inputs,
    draws: RandomInputs,
    training: bool,
) -> Loss {
    let lengths = inputs.lengths.clone();
    let weights = training.then(|| diffusion.loss_weights(&draws.timesteps));
    let tracking = training.then(|| tracking_loss(unet, &inputs)).flatten();
    let mut loss = kinegrad_train::denoising::denoising_loss(
        diffusion,
        inputs,
        draws,
        |x_t, time, cond, dropout| {
            let cond = AudioCondition {
                teacher_forcing: training,
                ..condition(cond, lengths)
            };
            unet.forward(x_t, time, cond, dropout)
        },
        |model_output, target, mask| {
            let loss_type = diffusion.config.loss_type;
            diffusion_loss(
                model_output,
                target,
                Some(mask),
                weights.as_deref(),
                loss_type,
            )
        },
    );
    if let Some(tracking) = tracking {
        loss.total = loss.total + tracking.clone();
        loss.terms.push(("beats", tracking));
    }
    loss
}

/// The mean squared error of the beat tracker, if any, over frames with beat labels.
fn tracking_loss(unet: &UNet1d, inputs: &Inputs) -> Option<Tensor<1>> {
    let cond = condition(&inputs.cond, inputs.lengths.clone());
    let found = unet.track_beats(&cond)?;
    let [batch, tracked, time] = found.dims();
    let (labels, is_known) = beat_labels(&cond.features);
    let mask = is_known * inputs.mask.clone().reshape([batch, 1, time]);
    let error = (found - labels).square() * mask.clone();
    let sum = |x: Tensor<3>| x.sum_dim(2).sum_dim(1).sum_dim(0).reshape([1]);
    Some(sum(error) / (sum(mask) * tracked as f64).clamp_min(1.0))
}

/// The unweighted denoising loss with tracked beats, as in sampling, on held-out phrases.
pub(super) fn denoising_validation_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    held_out: &HeldOut,
    device: &Device,
) -> f64 {
    held_out.mean_loss(diffusion, device, |inputs, draws| {
        denoising_loss(diffusion, unet, inputs, draws, false).total
    })
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use crate::network::AudioConditioning;
    use crate::network::BEAT_CHANNELS;
    use crate::network::Beats;
    use crate::network::UNet1dConfig;
    use burn::tensor::TensorData;
    use kinegrad_data::AUDIO;
    use kinegrad_diffusion::DiffusionConfig;
    use kinegrad_models::Initializer;

    use super::*;
    use kinegrad_train::denoising::Conditions;

    /// The tracker's loss covers only frames with beat labels.
    #[test]
    fn masked_unknown_and_padded_beats_have_no_loss() {
        let device = Device::flex();
        let (features, time) = (9 + BEAT_CHANNELS, 13);
        let config = UNet1dConfig {
            audio_conditioning: AudioConditioning::Aligned,
            beats: Beats::Tracked,
            context_dim: 32,
            ..UNet1dConfig::tiny()
        };
        let unet = config
            .init(25, features, &Initializer::new(3, &device))
            .expect("a network");
        let mut values = vec![0.0f32; 2 * features * time];
        for (index, value) in values.iter_mut().enumerate() {
            *value = ((index * 37) % 11) as f32 / 11.0;
        }
        let at = |sample: usize, row: usize, t: usize| (sample * features + row) * time + t;
        for (sample, t) in (0..2).flat_map(|sample| (0..time).map(move |t| (sample, t))) {
            let angle = TAU * (0.03 + t as f32 / 7.3);
            values[at(sample, 9, t)] = angle.sin();
            values[at(sample, 10, t)] = angle.cos();
        }
        // Unknown labels, half-masked labels, and labels replaced by noise.
        for t in 2..4 {
            values[at(0, 9, t)] = 0.0;
            values[at(0, 10, t)] = 0.0;
        }
        values[at(0, 9, 5)] = 0.0;
        values[at(0, 10, 6)] = 0.0;
        values[at(0, 9, 7)] = 0.9;
        values[at(0, 10, 7)] = -0.8;
        let unknown = [2, 3, 5, 6, 7];
        let audio = Tensor::<3>::from_data(
            TensorData::new(values.clone(), [2, features, time]),
            &device,
        );
        let mut mask = vec![1.0f32; 2 * time];
        mask[2 * time - 4..].fill(0.0);
        let inputs = Inputs {
            x_start: Tensor::zeros([2, 25, time], &device),
            cond: Conditions::new([(AUDIO, audio)]),
            mask: Tensor::from_data(TensorData::new(mask, [2, time]), &device),
            lengths: Some(kinegrad_kernels::Lengths::new([time, time - 4])),
        };
        let cond = condition(&inputs.cond, inputs.lengths.clone());
        let found = unet.track_beats(&cond).expect("a tracker");
        let found = found.into_data().try_into_vec::<f32>().expect("values");
        let (mut sum, mut count) = (0.0, 0.0);
        for (sample, t) in (0..2).flat_map(|sample| (0..time).map(move |t| (sample, t))) {
            if (sample == 0 && unknown.contains(&t)) || (sample == 1 && t >= time - 4) {
                continue;
            }
            for row in 0..2 {
                let error = found[(sample * 2 + row) * time + t] - values[at(sample, 9 + row, t)];
                sum += error * error;
                count += 1.0;
            }
        }
        let loss = tracking_loss(&unet, &inputs).expect("a tracker");
        let loss = loss.into_scalar::<f32>();
        assert!((loss - sum / count).abs() < 1e-5, "{loss} {}", sum / count);
    }

    /// Batches of one sample with different beat labels.
    fn labelled(start: f32, device: &Device) -> Inputs {
        let (features, time) = (9 + BEAT_CHANNELS, 13);
        let mut values = vec![0.0f32; features * time];
        for (index, value) in values[..9 * time].iter_mut().enumerate() {
            *value = ((index * 37) % 11) as f32 / 11.0;
        }
        for t in 0..time {
            let angle = TAU * (start + t as f32 / 7.3);
            (values[9 * time + t], values[10 * time + t]) = angle.sin_cos();
        }
        let audio = TensorData::new(values, [1, features, time]);
        Inputs {
            x_start: Tensor::ones([1, 25, time], device),
            cond: Conditions::new([(AUDIO, Tensor::from_data(audio, device))]),
            mask: Tensor::ones([1, time], device),
            lengths: None,
        }
    }

    #[test]
    fn teacher_forcing_is_on_in_training_and_off_in_validation() {
        let device = Device::flex();
        let config = UNet1dConfig {
            audio_conditioning: AudioConditioning::Aligned,
            beats: Beats::Tracked,
            context_dim: 32,
            ..UNet1dConfig::tiny()
        };
        let unet = config
            .init(25, 9 + BEAT_CHANNELS, &Initializer::new(3, &device))
            .expect("a network");
        let diffusion = GaussianDiffusion::new(&DiffusionConfig::default()).expect("a process");
        let loss = |start: f32, training: bool| {
            let draws = RandomInputs {
                timesteps: vec![600],
                noise: Tensor::ones([1, 25, 13], &device) * 0.5,
                condition_dropout_mask: None,
                style_dropout_mask: None,
                dropout: None,
            };
            let inputs = labelled(start, &device);
            let loss = denoising_loss(&diffusion, &unet, inputs, draws, training);
            let of_motion = loss
                .terms
                .into_iter()
                .find(|(name, _)| *name == "diffusion");
            let (_, of_motion) = of_motion.expect("the loss of the motion");
            [of_motion, loss.total].map(|loss| loss.into_scalar::<f32>())
        };
        let [early, late] = [0.11, 0.61].map(|start| loss(start, true));
        assert!((early[0] - late[0]).abs() > 1e-5, "{early:?} {late:?}");
        assert_eq!(loss(0.11, false), loss(0.61, false));
    }
}
