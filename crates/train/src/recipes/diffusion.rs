//! A denoiser on noised motion (CC-MotionGen documentation, sections 5.3 and 6.2):
//!
//! ```text
//! L = w(t) E |target - f(x_t, t, cond)|     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
//! ```
//!
//! with `t` uniform over the timesteps, the target chosen by `diffusion.prediction_type`, the
//! distance by `diffusion.loss_type`, and the condition replaced by zeros with probability
//! `diffusion.cond_drop_prob`, so that classifier-free guidance has a null condition it knows.

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{AUDIO_CHANNELS, Batch, Phrase, collate_validation};
use kinegrad_diffusion::{GaussianDiffusion, diffusion_loss};
use kinegrad_models::UNet1d;
use kinegrad_motion::TrainingStatistics;
use kinegrad_motion::phrase::CHANNELS;
use kinegrad_random::{Key, Purpose};

use super::{Loss, Recipe, StepKey};
use crate::config::ValidationConfig;

/// Trains a [`UNet1d`] to denoise.
pub struct DiffusionRecipe {
    diffusion: GaussianDiffusion,
    validation: ValidationConfig,
    held_out: Vec<Arc<Phrase>>,
    statistics: Arc<TrainingStatistics>,
    target_frames: usize,
}

/// A batch on the device.
struct Inputs {
    /// `[batch, 25, time]`, normalised.
    x_start: Tensor<3>,
    /// `[batch, 163, time]`.
    cond: Tensor<3>,
    /// `[batch, time]`, 1 where a frame is real.
    mask: Tensor<2>,
}

impl Inputs {
    fn new(batch: &Batch, device: &Device) -> Self {
        let (size, time) = (batch.batch_size, batch.frames);
        let on_device = |values: &[f32], channels: usize| {
            Tensor::from_data(
                TensorData::new(values.to_vec(), [size, channels, time]),
                device,
            )
        };
        Self {
            x_start: on_device(&batch.x_start, CHANNELS),
            cond: on_device(&batch.cond, AUDIO_CHANNELS),
            mask: Tensor::from_data(TensorData::new(batch.mask.clone(), [size, time]), device),
        }
    }
}

impl DiffusionRecipe {
    /// A recipe over `diffusion`, validated on `held_out`.
    pub fn new(
        diffusion: GaussianDiffusion,
        validation: &ValidationConfig,
        held_out: Vec<Arc<Phrase>>,
        statistics: Arc<TrainingStatistics>,
        target_frames: usize,
    ) -> Self {
        Self {
            diffusion,
            validation: validation.clone(),
            held_out,
            statistics,
            target_frames,
        }
    }

    /// Zeros the condition of samples chosen by `key`.
    fn drop_cond(&self, cond: Tensor<3>, key: Key) -> Tensor<3> {
        let prob = self.diffusion.config.cond_drop_prob;
        if prob == 0.0 {
            return cond;
        }
        let [batch, ..] = cond.dims();
        let keep: Vec<f32> = key
            .uniforms(batch)
            .iter()
            .map(|&u| f32::from(f64::from(u) >= prob))
            .collect();
        let keep = Tensor::from_data(TensorData::new(keep, [batch, 1, 1]), &cond.device());
        cond * keep
    }
}

impl Recipe for DiffusionRecipe {
    type Model = UNet1d;

    fn group(&self) -> &'static str {
        "unet"
    }

    fn loss(&self, model: &UNet1d, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let Inputs {
            x_start,
            cond,
            mask,
        } = Inputs::new(batch, device);
        let num_train_timesteps = self.diffusion.config.num_train_timesteps;
        let timesteps = key
            .of(Purpose::Timesteps)
            .integers(batch.batch_size, num_train_timesteps);
        let noise = noise(key.of(Purpose::Noise), x_start.dims(), device);

        let x_t = self
            .diffusion
            .add_noise(x_start.clone(), noise.clone(), &timesteps);
        let cond = self.drop_cond(cond, key.of(Purpose::CondDropout));
        let dropout = Some(key.of(Purpose::Dropout));
        let model_output = model.forward(x_t.clone(), &timesteps, cond.clone(), dropout);

        let target = self.diffusion.target(x_start.clone(), noise, &timesteps);
        let weights = self.diffusion.loss_weights(&timesteps);
        let total = diffusion_loss(
            model_output.clone(),
            target,
            Some(mask),
            Some(&weights),
            self.diffusion.config.loss_type,
        );
        Loss {
            terms: vec![("diffusion", total.clone())],
            probes: vec![
                ("x_start", x_start),
                ("cond", cond),
                ("x_t", x_t),
                ("model_output", model_output),
            ],
            total,
        }
    }

    /// Draw k of phrase p of P uses `t = floor((k P + p + 0.5) T / (draws P))`: the draws of all
    /// phrases together cover the timesteps evenly, and the same ones each time. The noise is
    /// keyed by phrase and draw alone, so that runs with other seeds compare too.
    fn validation_loss(&self, model: &UNet1d, device: &Device) -> f64 {
        let phrases = self.held_out.len();
        let draws = self.validation.draws;
        let num_train_timesteps = self.diffusion.config.num_train_timesteps;
        let mut sum = 0.0;
        for draw in 0..draws {
            for start in (0..phrases).step_by(self.validation.batch_size) {
                let end = (start + self.validation.batch_size).min(phrases);
                let chunk = &self.held_out[start..end];
                let batch = collate_validation(chunk, &self.statistics, self.target_frames);
                let Inputs {
                    x_start,
                    cond,
                    mask,
                } = Inputs::new(&batch, device);
                let timesteps: Vec<usize> = (start..end)
                    .map(|p| {
                        let twice = 2 * (draw * phrases + p) + 1;
                        twice * num_train_timesteps / (2 * draws * phrases)
                    })
                    .collect();
                let per_phrase = x_start.dims().iter().skip(1).product();
                let values: Vec<f32> = chunk
                    .iter()
                    .flat_map(|phrase| {
                        let key = Key::new(0, Purpose::Validation).named(&phrase.id);
                        key.at(draw as u64).normals(per_phrase)
                    })
                    .collect();
                let noise = Tensor::from_data(TensorData::new(values, x_start.dims()), device);
                let x_t = self
                    .diffusion
                    .add_noise(x_start.clone(), noise.clone(), &timesteps);
                let model_output = model.forward(x_t, &timesteps, cond, None);
                let target = self.diffusion.target(x_start, noise, &timesteps);
                let loss_type = self.diffusion.config.loss_type;
                let loss = diffusion_loss(model_output, target, Some(mask), None, loss_type);
                sum += f64::from(loss.into_scalar::<f32>()) * (end - start) as f64;
            }
        }
        sum / (draws * phrases) as f64
    }
}

fn noise(key: Key, shape: [usize; 3], device: &Device) -> Tensor<3> {
    Tensor::from_data(
        TensorData::new(key.normals(shape.iter().product()), shape),
        device,
    )
}
