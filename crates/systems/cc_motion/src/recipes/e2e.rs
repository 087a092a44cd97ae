//! End-to-end training of denoiser and decoder through the sampler (CC-MotionGen, section 7;
//! docs/sources.md, section 1.8):
//!
//! ```text
//! L = w_diff L_diff + w_dec (L_pos + L_quat) + w_temp sum L_temp + w_components L_all
//!
//! L_diff   the diffusion loss, on normalised motion
//! decoded  decoder(DDIM of K steps), with gradients to every call of the network
//! L_pos, L_quat   squared error of the decoded position and quaternion
//! L_temp   temporal coherence of the decoded motion
//! L_all    squared error of all components in units of their deviations (not CC-MotionGen's)
//! ```
//!
//! Dropout is off inside the rollout. A rollout starts from the batch's noised motion
//! (`rollout.start`), and the signal remaining in the start weights the reconstruction: without
//! signal, a reconstruction loss would pull all samples towards the mean motion.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_diffusion::{Trace, rollout_timesteps};
use kinegrad_models::{DropoutKey, GradientSum};
use kinegrad_random::Purpose;
use kinegrad_train::denoising::{HeldOut, Inputs, RandomInputs, noise};
use kinegrad_train::{Loss, Measured, Recipe, StepKey};

use super::Rollouts;
use super::diffusion::{denoising_loss, denoising_validation_loss};
use crate::LossConfig;
use crate::losses::{ReconstructionLoss, temporal_losses};
use crate::network::{AudioCondition, MotionModel};
use crate::style::condition;

/// Index of the start noise of held-out rollouts, independent of `validation.draws`.
const ROLLOUT_DRAW: u64 = 1;

/// Fine-tunes a [`MotionModel`].
pub struct E2eRecipe {
    rollouts: Rollouts,
    loss: LossConfig,
    held_out: HeldOut,
}

/// The state for the backward pass of a checkpointed rollout.
#[derive(Debug)]
pub struct PendingRollout {
    trace: Trace,
    cond: AudioCondition,
}

/// The random inputs of one batch's loss.
#[derive(Clone, Debug)]
pub struct E2eRandomInputs {
    /// Inputs of the diffusion loss.
    pub denoising: RandomInputs,
    /// Start timestep of each sample's rollout.
    pub starts: Vec<usize>,
    /// Start noise of the rollout, standard normal: `[batch, channels, time]`.
    pub start_noise: Tensor<3>,
    /// The decoder's dropout.
    pub decoder_dropout: DropoutKey,
}

impl E2eRecipe {
    /// A recipe with rollouts by `rollouts`, validated on `held_out`.
    pub fn new(rollouts: Rollouts, loss: &LossConfig, held_out: HeldOut) -> Self {
        Self {
            rollouts,
            loss: loss.clone(),
            held_out,
        }
    }

    /// The loss of a batch and its random inputs.
    pub fn loss_of(
        &self,
        model: &MotionModel,
        inputs: Inputs,
        draws: E2eRandomInputs,
    ) -> Loss<Option<PendingRollout>> {
        let E2eRandomInputs {
            denoising,
            starts,
            start_noise,
            decoder_dropout,
        } = draws;
        // 1. The diffusion loss.
        let (rollouts, w_diff) = (&self.rollouts, self.loss.w_diff);
        let diffusion = &rollouts.rollout.diffusion;
        let denoising = denoising_loss(diffusion, &model.unet, inputs.clone(), denoising, true);
        let mut total = denoising.total * w_diff;
        let weighted = denoising.terms.into_iter();
        let mut terms: Vec<_> = weighted.map(|(name, term)| (name, term * w_diff)).collect();

        // 2. A rollout, with gradients by `rollout.mode`.
        let cond = condition(&inputs.cond, inputs.lengths.clone());
        let output = rollouts.rollout.run(
            &model.unet,
            &model.unet.valid(),
            rollouts.start(&inputs.x_start, start_noise, &starts),
            &cond,
            &rollout_timesteps(&starts, rollouts.config.steps),
            rollouts.config.graph(),
        );
        let output = output.expect("bounds of all channels");
        let pending = output.trace.map(|trace| PendingRollout { trace, cond });

        // 3. The losses of the decoded latent.
        let decoded = model.decoder.forward(output.x.clone(), decoder_dropout);
        for (name, term) in self.decoded_terms(&decoded, &inputs, &starts) {
            total = total + term.clone();
            terms.push((name, term));
        }
        let mut probes = denoising.probes;
        probes.extend([("latent", output.x), ("decoded", decoded)]);
        Loss {
            total,
            terms,
            probes,
            pending,
        }
    }

    /// The weighted terms of decoded motion, by name.
    fn decoded_terms(
        &self,
        decoded: &Tensor<3>,
        inputs: &Inputs,
        starts: &[usize],
    ) -> Vec<(&'static str, Tensor<1>)> {
        let (rollouts, loss, mask) = (&self.rollouts, &self.loss, &inputs.mask);
        let target = rollouts.physical(&inputs.x_start);
        let weighting = loss.reconstruction_weighting;
        let weights = rollouts.weights(starts, weighting, &decoded.device());
        let sign = loss.quaternion_sign;
        let error = ReconstructionLoss::new(decoded, &target, mask, weights.clone(), sign);
        let mut terms = vec![
            ("position", error.position * loss.w_dec),
            ("quaternion", error.quaternion * loss.w_dec),
        ];
        if loss.w_components > 0.0 {
            let error = rollouts.normalized_error(decoded, &target, mask, weights);
            terms.push(("components", error * loss.w_components));
        }
        let temporal = temporal_losses(decoded, mask, &loss.temporal);
        terms.extend(
            temporal
                .into_iter()
                .map(|(name, term)| (name, term * self.loss.w_temp)),
        );
        terms
    }
}

impl Recipe for E2eRecipe {
    type Model = MotionModel;
    type Pending = Option<PendingRollout>;

    fn group_of(&self, parameter: &str) -> usize {
        usize::from(parameter.starts_with("decoder."))
    }

    fn measures_first(&self) -> bool {
        true
    }

    fn loss(
        &self,
        model: &MotionModel,
        batch: &Batch,
        key: StepKey,
        device: &Device,
    ) -> Loss<Self::Pending> {
        let inputs = Inputs::new(batch, device);
        let (rollouts, shape) = (&self.rollouts, inputs.x_start.dims());
        let diffusion = &rollouts.rollout.diffusion;
        let draws = E2eRandomInputs {
            denoising: RandomInputs::new(diffusion, &inputs, key, device),
            starts: rollouts.sample_starts(shape[0], key.of(Purpose::RolloutTimesteps)),
            start_noise: noise(key.of(Purpose::RolloutNoise), shape, device),
            decoder_dropout: Some(key.of(Purpose::DecoderDropout)),
        };
        self.loss_of(model, inputs, draws)
    }

    fn backward(&self, model: &MotionModel, loss: Loss<Self::Pending>) -> GradientSum {
        let mut sum = GradientSum::default();
        let mut gradients = loss.total.backward();
        if let Some(PendingRollout { trace, cond }) = loss.pending {
            let (rollout, unet) = (&self.rollouts.rollout, &model.unet);
            trace
                .backward(rollout, unet, &cond, &mut gradients, &mut |_, mut local| {
                    sum.add(model, &mut local);
                })
                .expect("it ran forwards");
        }
        sum.add(model, &mut gradients);
        sum
    }

    /// The loss without dropout, with evenly spaced start timesteps.
    fn validation_loss(&self, model: &MotionModel, device: &Device) -> Measured {
        let diffusion = &self.rollouts.rollout.diffusion;
        let phrases = self.held_out.len();
        let denoising = denoising_validation_loss(diffusion, &model.unet, &self.held_out, device);
        let mut measured = Measured::default();
        measured.add("diffusion", denoising * self.loss.w_diff);
        let starts = self.rollouts.starts(phrases, |_| 0.5);
        let decoded = self.held_out.mean_terms(|range, batch| {
            let inputs = Inputs::new(&batch, device);
            let starts = &starts[range.clone()];
            let noise = self.held_out.noise(range, ROLLOUT_DRAW, &inputs.x_start);
            let latent = self.rollouts.sample(&model.unet, &inputs, noise, starts);
            let decoded = model.decoder.forward(latent, None);
            self.decoded_terms(&decoded, &inputs, starts)
        });
        for (name, term) in decoded.terms {
            measured.add(name, term);
        }
        measured
    }
}
