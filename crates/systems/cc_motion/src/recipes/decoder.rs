//! A motion decoder on the latents of a frozen denoiser (CC-MotionGen, section 3.3;
//! docs/sources.md, section 1.6).
//!
//! ```text
//! L = w_dec |decoder(latent) - motion|^2 / std^2
//! ```
//!
//! The loss has no temporal term: the decoder processes one frame at a time, so it could only
//! reduce jitter by reducing motion. The decoder is trained on two latents of each phrase: the
//! phrase with low noise, and a DDIM sample started from the phrase with high noise (`rollout`).
//! The error of the DDIM sample is weighted by the signal remaining in the start. The denoiser is
//! part of the checkpoint and is not trained.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::denoising::{HeldOut, Inputs, noise};
use kinegrad_train::{Loss, Measured, Recipe, StepKey};

use super::Rollouts;
use crate::network::MotionModel;
use crate::{LossConfig, ReconstructionWeighting};

/// Share of timesteps, from 0, for the noised latents.
const NOISED_SHARE: f64 = 0.05;

/// Trains the decoder of a [`MotionModel`].
pub struct DecoderRecipe {
    rollouts: Rollouts,
    loss: LossConfig,
    held_out: HeldOut,
}

impl DecoderRecipe {
    /// A recipe with latents sampled by `rollouts`, validated on `held_out`.
    pub fn new(rollouts: Rollouts, loss: &LossConfig, held_out: HeldOut) -> Self {
        Self {
            rollouts,
            loss: loss.clone(),
            held_out,
        }
    }

    /// The phrases with low noise, at timesteps spread by `place`.
    fn noised(
        &self,
        x_start: &Tensor<3>,
        noise: Tensor<3>,
        place: impl Fn(usize) -> f64,
    ) -> Tensor<3> {
        let diffusion = &self.rollouts.rollout.diffusion;
        let below = diffusion.config.num_train_timesteps as f64 * NOISED_SHARE;
        let timesteps = (0..x_start.dims()[0]).map(|i| (place(i) * below) as usize);
        let timesteps: Vec<usize> = timesteps.collect();
        diffusion.add_noise(x_start.clone(), noise, &timesteps)
    }

    /// The weighted terms of both latents, by name.
    fn terms(
        &self,
        model: &MotionModel,
        inputs: &Inputs,
        latents: [Tensor<3>; 2],
        starts: &[usize],
        dropout: Option<Key>,
    ) -> [(&'static str, Tensor<1>); 2] {
        let (rollouts, device) = (&self.rollouts, inputs.x_start.device());
        let target = rollouts.physical(&inputs.x_start);
        let error = |call: u64, latent: Tensor<3>, weighting| {
            let dropout = dropout.map(|key| key.at(call));
            let decoded = model.decoder.forward(latent, dropout);
            let weights = rollouts.weights(starts, weighting, &device);
            rollouts.normalized_error(&decoded, &target, &inputs.mask, weights) * self.loss.w_dec
        };
        let [noised, sampled] = latents;
        let noised = error(0, noised, ReconstructionWeighting::Uniform);
        let sampled = error(1, sampled, self.loss.reconstruction_weighting);
        [
            ("reconstruction_noised", noised),
            ("reconstruction_sampled", sampled),
        ]
    }
}

impl Recipe for DecoderRecipe {
    type Model = MotionModel;
    type Pending = ();

    fn measures_first(&self) -> bool {
        true
    }

    fn loss(&self, model: &MotionModel, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let shape = inputs.x_start.dims();
        let places = key.of(Purpose::Timesteps).uniforms(shape[0]);
        let little = noise(key.of(Purpose::Noise), shape, device);
        let noised = self.noised(&inputs.x_start, little, |i| f64::from(places[i]));
        let rollouts = &self.rollouts;
        let starts = rollouts.sample_starts(shape[0], key.of(Purpose::RolloutTimesteps));
        let much = noise(key.of(Purpose::RolloutNoise), shape, device);
        let sampled = rollouts.sample(&model.unet.valid(), &inputs, much, &starts);
        let dropout = Some(key.of(Purpose::DecoderDropout));
        let latents = [noised.clone(), sampled.clone()];
        let terms = self.terms(model, &inputs, latents, &starts, dropout);
        Loss {
            total: terms[0].1.clone() + terms[1].1.clone(),
            terms: terms.to_vec(),
            probes: vec![("noised latent", noised), ("sampled latent", sampled)],
            pending: (),
        }
    }

    fn validation_loss(&self, model: &MotionModel, device: &Device) -> Measured {
        let phrases = self.held_out.len();
        let starts = self.rollouts.starts(phrases, |_| 0.5);
        self.held_out.mean_terms(|range, batch| {
            let inputs = Inputs::new(&batch, device);
            let starts = &starts[range.clone()];
            let noise = |draw| self.held_out.noise(range.clone(), draw, &inputs.x_start);
            let places = |i: usize| ((range.start + i) as f64 + 0.5) / phrases as f64;
            let latents = [
                self.noised(&inputs.x_start, noise(0), places),
                self.rollouts.sample(&model.unet, &inputs, noise(1), starts),
            ];
            self.terms(model, &inputs, latents, starts, None).into()
        })
    }
}
