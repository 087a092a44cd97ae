//! The sampler in training: samples latents from a batch.

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{ClipRange, GaussianDiffusion, Rollout, RolloutMode, rollout_timesteps};
use kinegrad_motion::{ChannelEncoding, PhaseEncoding, Statistics};
use kinegrad_random::Key;
use kinegrad_train::Error;
use kinegrad_train::denoising::Inputs;

use crate::losses::reconstruction::{normalized_error, with_nearer_phase};
use crate::network::UNet1d;
use crate::network::channel_encoding::decode;
use crate::style::condition;
use crate::{ReconstructionWeighting, RolloutConfig, RolloutStart};

/// Rollouts according to the table `rollout`.
pub struct Rollouts {
    pub(super) rollout: Rollout,
    pub(super) config: RolloutConfig,
    pub(super) statistics: Arc<Statistics>,
    pub(super) targets: ChannelEncoding,
    /// Standard deviations of the 25 channels, the units of errors of decoded motion.
    pub(super) std: Vec<f64>,
}

impl Rollouts {
    /// Rollouts of `diffusion` over motion normalized by `statistics`.
    ///
    /// # Errors
    /// If the range of the training motion is unknown.
    pub fn new(
        diffusion: GaussianDiffusion,
        config: &RolloutConfig,
        statistics: Arc<Statistics>,
    ) -> Result<Self, Error> {
        let mut clip = config
            .clip
            .range(config.clip_range, &statistics, statistics.channels())?;
        if config.straight_through {
            clip = ClipRange::StraightThrough(Box::new(clip));
        }
        Ok(Self {
            rollout: Rollout {
                diffusion,
                clip,
                guidance: config.guidance(),
                gradient_decay: config.gradient_decay,
            },
            config: config.clone(),
            std: statistics.std.clone(),
            targets: ChannelEncoding::default(),
            statistics,
        })
    }

    /// The same rollouts over motion in the channels of `targets`; `stored` are statistics of the
    /// 25 channels.
    #[must_use]
    pub fn with_targets(self, targets: ChannelEncoding, stored: &Statistics) -> Self {
        Self {
            targets,
            std: stored.std.clone(),
            ..self
        }
    }

    /// Start timesteps of a batch. Rollouts from pure noise start at the last timestep. Otherwise
    /// the configured range has `batch` equal parts, and part i gives the timestep at its fraction
    /// `place(i)` in [0, 1).
    pub(super) fn starts(&self, batch: usize, place: impl Fn(usize) -> f64) -> Vec<usize> {
        let last = self.rollout.diffusion.config.num_train_timesteps - 1;
        if self.config.start == RolloutStart::Noise {
            return vec![last; batch];
        }
        let [lowest, highest] = self.config.start_timesteps.map(|t| t.min(last));
        let width = (highest - lowest + 1) as f64;
        let start = |i: usize| {
            let part = (i as f64 + place(i)) / batch as f64;
            lowest + ((part * width) as usize).min(highest - lowest)
        };
        (0..batch).map(start).collect()
    }

    /// [`starts`](Self::starts) at timesteps sampled from `key`.
    pub(super) fn sample_starts(&self, batch: usize, key: Key) -> Vec<usize> {
        let places = key.uniforms(batch);
        self.starts(batch, |i| f64::from(places[i]))
    }

    /// The start state of a rollout.
    pub(super) fn start(
        &self,
        x_start: &Tensor<3>,
        noise: Tensor<3>,
        starts: &[usize],
    ) -> Tensor<3> {
        match self.config.start {
            RolloutStart::Noise => noise,
            RolloutStart::Motion => {
                let diffusion = &self.rollout.diffusion;
                diffusion.add_noise(x_start.clone(), noise, starts)
            }
        }
    }

    /// Latents sampled for the batch, without gradients: `[batch, channels, time]`.
    pub(super) fn sample(
        &self,
        unet: &UNet1d,
        inputs: &Inputs,
        noise: Tensor<3>,
        starts: &[usize],
    ) -> Tensor<3> {
        let output = self.rollout.run(
            unet,
            unet,
            self.start(&inputs.x_start, noise, starts),
            &condition(&inputs.cond, inputs.lengths.clone()),
            &rollout_timesteps(starts, self.config.steps),
            RolloutMode::LastK(0),
        );
        output.expect("bounds of all channels").x.without_autodiff()
    }

    /// The weight of each sample's reconstruction: `[batch, 1, 1]`.
    pub(super) fn weights(
        &self,
        starts: &[usize],
        weighting: ReconstructionWeighting,
        device: &Device,
    ) -> Tensor<3> {
        let abar = &self.rollout.diffusion.schedule.alphas_cumprod;
        let weight = |&t: &usize| match weighting {
            ReconstructionWeighting::Uniform => 1.0,
            ReconstructionWeighting::Signal => abar[t] as f32,
        };
        let weights: Vec<f32> = starts.iter().map(weight).collect();
        Tensor::from_data(TensorData::new(weights, [starts.len(), 1, 1]), device)
    }

    /// Converts normalized motion to physical units: `[batch, 25, time]`.
    pub(super) fn physical(&self, x: &Tensor<3>) -> Tensor<3> {
        let of_channels = |values: &[f64]| channels(values, &x.device());
        let std = of_channels(&self.statistics.std);
        decode(
            self.targets,
            x.clone() * std + of_channels(&self.statistics.mean),
        )
    }

    /// The mean squared error of all components in units of their standard deviations.
    pub(super) fn normalized_error(
        &self,
        decoded: &Tensor<3>,
        target: &Tensor<3>,
        mask: &Tensor<2>,
        weights: Tensor<3>,
    ) -> Tensor<1> {
        let std = channels(&self.std, &decoded.device());
        let target = match self.targets.phase {
            PhaseEncoding::Scalar => target.clone(),
            PhaseEncoding::SinCos | PhaseEncoding::Harmonics => with_nearer_phase(target, decoded),
        };
        normalized_error(decoded, &target, mask, weights, &std)
    }
}

/// One value per channel: `[1, channels, 1]`.
pub(super) fn channels(values: &[f64], device: &Device) -> Tensor<3> {
    let values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
    let shape = [1, values.len(), 1];
    Tensor::from_data(TensorData::new(values, shape), device)
}
