//! What the recipes on clips of joint features share: a batch on the device, its draws, the masked
//! loss, and the held-out clips.

use std::ops::Range;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::humanml::{Clip, collate_clips};
use kinegrad_data::{Batch, DataConfig};
use kinegrad_diffusion::{GaussianDiffusion, Time};
use kinegrad_models::TextDenoiser;
use kinegrad_motion::humanml::FeatureStatistics;
use kinegrad_random::{Key, Purpose};

use crate::config::ValidationConfig;
use crate::draws::{keep_cond, noise, spread_timesteps};
use crate::recipe::{Loss, Measured, StepKey};

/// A batch on the device.
#[derive(Clone, Debug)]
pub struct ClipInputs {
    /// `[batch, channels, time]`, normalised.
    pub x_start: Tensor<3>,
    /// Pooled text features, zeros where there is no text: `[batch, 512, 1]`.
    pub text: Tensor<3>,
    /// `[batch, time]`, 1 where a frame is real.
    pub mask: Tensor<2>,
}

impl ClipInputs {
    /// Copies `batch` to `device`.
    pub fn new(batch: &Batch, device: &Device) -> Self {
        let (size, time) = (batch.batch_size, batch.frames);
        let on_device = |values: &[f32], shape: [usize; 3]| -> Tensor<3> {
            Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
        };
        Self {
            x_start: on_device(&batch.x_start, [size, batch.channels, time]),
            text: on_device(&batch.cond, [size, batch.cond_channels, batch.cond_frames]),
            mask: Tensor::from_data(TensorData::new(batch.mask.clone(), [size, time]), device),
        }
    }
}

/// What is random in the loss of one batch.
#[derive(Clone, Debug)]
pub struct ClipDraws {
    /// One timestep a sample.
    pub timesteps: Vec<usize>,
    /// Standard normal: `[batch, channels, time]`.
    pub noise: Tensor<3>,
    /// 0 where the text is dropped, else 1: `[batch, 1, 1]`. None drops none.
    pub keep_text: Option<Tensor<3>>,
}

impl ClipDraws {
    /// The draws of `key` for a batch of this shape.
    pub fn new(
        diffusion: &GaussianDiffusion,
        shape: [usize; 3],
        key: StepKey,
        device: &Device,
    ) -> Self {
        let config = &diffusion.config;
        Self {
            timesteps: key
                .of(Purpose::Timesteps)
                .integers(shape[0], config.num_train_timesteps),
            noise: noise(key.of(Purpose::Noise), shape, device),
            keep_text: keep_cond(config.cond_drop_prob, shape[0], key, device),
        }
    }
}

/// A training batch with its draws.
pub(super) fn prepare(
    diffusion: &GaussianDiffusion,
    batch: &Batch,
    key: StepKey,
    device: &Device,
) -> (ClipInputs, ClipDraws) {
    let inputs = ClipInputs::new(batch, device);
    let draws = ClipDraws::new(diffusion, inputs.x_start.dims(), key, device);
    (inputs, draws)
}

/// The loss of one batch, `x_start` standing in the network's space:
///
/// ```text
/// L = mean over the batch of  sum over real frames and channels  w_c (target - f(x_t, t, text))^2
///                             / real frames                       with the w_c adding up to 1
/// ```
///
/// Source: GMD's published program (docs/sources.md, section 4.10).
pub fn clip_loss(
    diffusion: &GaussianDiffusion,
    model: &TextDenoiser,
    inputs: ClipInputs,
    draws: ClipDraws,
    channel_weights: &[f64],
) -> Loss {
    let ClipInputs {
        x_start,
        text,
        mask,
    } = inputs;
    let ClipDraws {
        timesteps,
        noise,
        keep_text,
    } = draws;
    let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
    let text = match keep_text {
        Some(keep) => text * keep,
        None => text,
    };
    let model_output = model.forward(x_t.clone(), &Time::of(&timesteps), text.clone());
    let target = diffusion.target(x_start.clone(), noise, &timesteps);
    let total = weighted_masked_mse(model_output.clone(), target, mask, channel_weights);
    Loss {
        terms: vec![("diffusion", total.clone())],
        probes: vec![
            ("x_start", x_start),
            ("text", text),
            ("x_t", x_t),
            ("model_output", model_output),
        ],
        total,
        pending: (),
    }
}

/// The loss above of an output.
///
/// # Shapes
/// - model_output, target: `[batch, channels, time]`
/// - mask: `[batch, time]`; a sample without a real frame counts as 0
pub fn weighted_masked_mse(
    model_output: Tensor<3>,
    target: Tensor<3>,
    mask: Tensor<2>,
    channel_weights: &[f64],
) -> Tensor<1> {
    let [batch, channels, time] = model_output.dims();
    assert_eq!(channel_weights.len(), channels, "one weight a channel");
    let sum: f64 = channel_weights.iter().sum();
    let weights: Vec<f32> = channel_weights.iter().map(|w| (w / sum) as f32).collect();
    let device = model_output.device();
    let weights: Tensor<3> = Tensor::from_data(TensorData::new(weights, [1, channels, 1]), &device);
    let difference = model_output - target;
    let squares = difference.clone() * difference * weights;
    // In a fixed order, whatever the number of threads: channels, frames, then the batch.
    let frames = squares.sum_dim(1).reshape([batch, time]) * mask.clone();
    let real = mask.sum_dim(1).clamp_min(1.0);
    (frames.sum_dim(1) / real).sum() / batch as f64
}

/// The clips a recipe is measured on.
pub struct HeldOutClips {
    clips: Vec<Arc<Clip>>,
    statistics: Arc<FeatureStatistics>,
    channels: Range<usize>,
    data: DataConfig,
    draws: usize,
    batch_size: usize,
}

impl HeldOutClips {
    /// `channels` of `clips`, cut and padded as `data` says.
    pub fn new(
        clips: Vec<Arc<Clip>>,
        statistics: Arc<FeatureStatistics>,
        channels: Range<usize>,
        data: &DataConfig,
        validation: &ValidationConfig,
    ) -> Self {
        Self {
            clips,
            statistics,
            channels,
            data: data.clone(),
            draws: validation.draws,
            batch_size: validation.batch_size,
        }
    }

    fn collate(&self, clips: &[Arc<Clip>]) -> Batch {
        collate_clips(clips, &self.statistics, self.channels.clone(), &self.data)
    }

    /// The mean loss over all clips and draws, `loss` being that of one batch: evenly spread
    /// timesteps and noise keyed by clip and draw alone, so that runs compare.
    pub(super) fn measure(
        &self,
        num_train_timesteps: usize,
        device: &Device,
        loss: impl Fn(ClipInputs, ClipDraws) -> Loss,
    ) -> Measured {
        let (all, draws) = (self.clips.len(), self.draws);
        let mut sum = 0.0;
        for draw in 0..draws {
            for start in (0..all).step_by(self.batch_size) {
                let range = start..(start + self.batch_size).min(all);
                let clips = &self.clips[range.clone()];
                let inputs = ClipInputs::new(&self.collate(clips), device);
                let [_, channels, time] = inputs.x_start.dims();
                let values: Vec<f32> = clips
                    .iter()
                    .flat_map(|clip| {
                        let key = Key::new(0, Purpose::Validation).named(&clip.id);
                        key.at(draw as u64).normals(channels * time)
                    })
                    .collect();
                let noise = TensorData::new(values, inputs.x_start.dims());
                let given = ClipDraws {
                    timesteps: spread_timesteps(
                        range.clone(),
                        draw,
                        draws,
                        all,
                        num_train_timesteps,
                    ),
                    noise: Tensor::from_data(noise, device),
                    keep_text: None,
                };
                let loss = loss(inputs, given).total.into_scalar::<f32>();
                sum += f64::from(loss) * range.len() as f64;
            }
        }
        Measured {
            total: sum / (draws * all) as f64,
            terms: Vec::new(),
        }
    }
}
