//! A sampler that gradients pass through, from the motion back to the start noise and the network
//! (CC-MotionGen, section 7.3; docs/sources.md, section 1.8).
//!
//! A rollout is deterministic DDIM over K timesteps, run in training. Its memory is what
//! [`RolloutMode`] chooses between: one graph over all steps; no graph, with each step recomputed
//! in the backward pass ([`Trace::backward`]); or a graph over the last steps alone.
//!
//! The cosine schedule makes the naive rollout useless: from t = 999 of 1000 a noise prediction is
//! multiplied by 1/sqrt(abar) = 64179. What tames it is a matter of settings: predict the clean
//! motion, clip it ([`Clip::StraightThrough`]), start from a lower timestep, let the gradient
//! decay from step to step (`gradient_decay`).

use burn::tensor::{GradientCheckpointingStrategy, Gradients, Tensor};

use crate::sampler::{SamplerConfig, StepInput, ddim_step};
use crate::{Clip, Denoiser, Error, GaussianDiffusion, guided};

/// What a rollout keeps for its backward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RolloutMode {
    /// One graph over all steps.
    Full,
    /// The K + 1 states. The backward pass recomputes each step with a graph of its own and
    /// carries its vector-Jacobian product on: the gradients of `Full` in the memory of one step,
    /// for one more forward pass.
    Checkpointed,
    /// A graph over the last k steps; the gradient ends there (DRaFT-K, Clark et al. 2024,
    /// <https://arxiv.org/abs/2309.17400>, section 4.1).
    LastK(usize),
}

/// The settings of a rollout.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// The process, whose prediction type the network has.
    pub diffusion: GaussianDiffusion,
    /// What the predicted clean motion is clipped to.
    pub clip: Clip,
    /// Weight of the condition: 1 as trained ([`guided`]).
    pub guidance_scale: f64,
    /// Factor on the gradient that a step hands to the one before it: 1 leaves it exact.
    pub gradient_decay: f64,
}

/// What a rollout leads to.
#[derive(Debug)]
pub struct RolloutOutput {
    /// The final state on the autodiff device: `[batch, channels, time]`.
    pub x: Tensor<3>,
    /// The state where the graph begins, which has a gradient: the start noise for
    /// [`RolloutMode::Full`], the state before the last k steps, or `x` itself for
    /// [`RolloutMode::Checkpointed`].
    pub entry: Tensor<3>,
    /// What [`Trace::backward`] goes on with where the graph of `x` ends; only in
    /// [`RolloutMode::Checkpointed`].
    pub trace: Option<Trace>,
}

/// The states of a rollout whose graph was not kept.
#[derive(Debug)]
pub struct Trace {
    /// The state before each step, then the final one, without a graph.
    states: Vec<Tensor<3>>,
    timesteps: Vec<Vec<usize>>,
    entry: Tensor<3>,
    strategy: Option<GradientCheckpointingStrategy>,
}

/// A state whose gradient is kept, with the setting of activation checkpointing of the network:
/// operations do not mix two settings.
fn tracked(state: Tensor<3>, strategy: Option<GradientCheckpointingStrategy>) -> Tensor<3> {
    let state = state.autodiff().require_grad();
    match strategy {
        Some(strategy) => state.with_gradient_checkpointing_strategy(strategy),
        None => state,
    }
}

/// The timesteps of a rollout of `steps` steps whose sample i begins at `starts[i]`:
/// `floor(start (K - 1 - k) / (K - 1))` for step k, one list of the whole batch per step. It ends
/// on the clean motion.
pub fn rollout_timesteps(starts: &[usize], steps: usize) -> Vec<Vec<usize>> {
    let last = steps.saturating_sub(1);
    (0..steps)
        .map(|k| {
            let at = |&start: &usize| (start * (last - k)).checked_div(last).unwrap_or(start);
            starts.iter().map(at).collect()
        })
        .collect()
}

impl Rollout {
    /// Runs the steps of `timesteps` ([`rollout_timesteps`]) from `x_start_noise` on. `plain` is
    /// `model` without gradients (Burn: `Module::valid`); both run the same operations.
    ///
    /// # Shapes
    /// - x_start_noise: `[batch, channels, time]`, best on the device of `model`; its graph, if any,
    ///   is not kept
    ///
    /// # Errors
    /// If the clipping bounds do not fit the channels, or the network's output has other sizes
    /// than its input.
    pub fn run<D: Denoiser + ?Sized>(
        &self,
        model: &D,
        plain: &D,
        x_start_noise: Tensor<3>,
        cond: &D::Cond,
        timesteps: &[Vec<usize>],
        mode: RolloutMode,
    ) -> Result<RolloutOutput, Error> {
        let steps = timesteps.len();
        let graph_from = match mode {
            RolloutMode::Full => 0,
            RolloutMode::Checkpointed => steps,
            RolloutMode::LastK(k) => steps.saturating_sub(k),
        };
        let strategy = x_start_noise.gradient_checkpointing_strategy();
        let mut states = vec![x_start_noise.without_autodiff()];
        for index in 0..graph_from {
            let x = states.last().expect("the start is one").clone();
            if mode != RolloutMode::Checkpointed {
                states.clear();
            }
            states.push(self.step(plain, x, cond, timesteps, index)?);
        }
        let entry = states.last().expect("the start is one").clone();
        let entry = tracked(entry, strategy);
        let mut x = entry.clone();
        for index in graph_from..steps {
            if index > graph_from && self.gradient_decay != 1.0 {
                let value = x.clone().without_autodiff();
                x = value.clone() + (x - value) * self.gradient_decay;
            }
            x = self.step(model, x, cond, timesteps, index)?;
        }
        let trace = (mode == RolloutMode::Checkpointed).then(|| Trace {
            states,
            timesteps: timesteps.to_vec(),
            entry: entry.clone(),
            strategy,
        });
        Ok(RolloutOutput { x, entry, trace })
    }

    /// One DDIM step without noise, the network included.
    fn step<D: Denoiser + ?Sized>(
        &self,
        model: &D,
        x: Tensor<3>,
        cond: &D::Cond,
        timesteps: &[Vec<usize>],
        index: usize,
    ) -> Result<Tensor<3>, Error> {
        let now = &timesteps[index];
        let prev: Vec<Option<usize>> = match timesteps.get(index + 1) {
            Some(next) => next.iter().copied().map(Some).collect(),
            None => vec![None; now.len()],
        };
        let input = StepInput {
            model_output: guided(model, x.clone(), now, cond, self.guidance_scale),
            x_t: x,
            noise: None,
            timesteps: now,
            prev_timesteps: &prev,
        };
        let output = ddim_step(
            &self.diffusion,
            input,
            &SamplerConfig::default(),
            &self.clip,
        )?;
        Ok(output.prev_sample)
    }
}

impl Trace {
    /// Goes on with the backward pass: takes the gradient of the final state out of `gradients`,
    /// and hands the gradients of each step to `each`, with the step's index, the last step first.
    /// Returns the gradient of the start noise.
    ///
    /// # Errors
    /// As [`Rollout::run`].
    pub fn backward<D: Denoiser + ?Sized>(
        self,
        rollout: &Rollout,
        model: &D,
        cond: &D::Cond,
        gradients: &mut Gradients,
        each: &mut dyn FnMut(usize, Gradients),
    ) -> Result<Tensor<3>, Error> {
        let Self {
            mut states,
            timesteps,
            entry,
            strategy,
        } = self;
        let last = states.pop().expect("a rollout has a final state");
        let mut cotangent = entry
            .grad_remove(gradients)
            .map_or_else(|| last.zeros_like(), Tensor::without_autodiff);
        drop(entry);
        for index in (0..timesteps.len()).rev() {
            let state = states.pop().expect("one state a step");
            let x = tracked(state, strategy);
            let y = rollout.step(model, x.clone(), cond, &timesteps, index)?;
            // The gradient of this sum with respect to y is the cotangent.
            let mut local = (y * cotangent).sum().backward();
            cotangent = x
                .grad_remove(&mut local)
                .expect("the state is part of its step")
                .without_autodiff();
            if index > 0 && rollout.gradient_decay != 1.0 {
                cotangent = cotangent * rollout.gradient_decay;
            }
            each(index, local);
        }
        Ok(cotangent)
    }
}

#[cfg(test)]
mod tests;
