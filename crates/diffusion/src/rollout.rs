//! A differentiable sampler: gradients flow from the motion to the start noise and the network
//! (CC-MotionGen, section 7.3; docs/sources.md, section 1.8).
//!
//! A rollout is deterministic DDIM over K timesteps during training. [`RolloutMode`] trades memory
//! for compute.
//!
//! With the cosine schedule a naive rollout is unstable: at t = 999 of 1000 a noise prediction is
//! multiplied by 1/sqrt(abar) = 64179. Remedies are prediction of the clean motion, clipping
//! ([`ClipRange::StraightThrough`]), a lower start timestep, and `gradient_decay`.

use std::ops::ControlFlow;

use burn::tensor::{GradientCheckpointingStrategy, Gradients, Tensor};

use kinegrad_random::{Key, Purpose};

use crate::{
    ClipRange, Ddim, Denoiser, Error, GaussianDiffusion, GuidanceScales, Prediction, Time,
    TimestepPath, ddim, guided,
};

/// The data that a rollout stores for its backward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RolloutMode {
    /// One graph over all steps.
    Full,
    /// The K + 1 states. [`Trace::backward`] recomputes each step with its own graph and chains the
    /// vector-Jacobian products. The gradients equal those of `Full`; memory is that of one step,
    /// for one more forward pass.
    Checkpointed,
    /// A graph over only the last k steps (DRaFT-K, Clark et al. 2024,
    /// <https://arxiv.org/abs/2309.17400>, section 4.1).
    LastK(usize),
}

/// The settings of a rollout.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// The process of the network.
    pub diffusion: GaussianDiffusion,
    /// Bounds of the predicted clean motion.
    pub clip: ClipRange,
    /// Guidance scales of the conditions ([`guided`]); 1 disables guidance.
    pub guidance: GuidanceScales,
    /// Factor of the gradient per step; 1 is the exact gradient.
    pub gradient_decay: f64,
}

/// The result of a rollout.
#[derive(Debug)]
pub struct RolloutOutput {
    /// The final state, on the autodiff device: `[batch, channels, time]`.
    pub x: Tensor<3>,
    /// The first state of the graph, which gets a gradient: the start noise
    /// ([`RolloutMode::Full`]), the state before the last k steps, or `x` itself
    /// ([`RolloutMode::Checkpointed`]).
    pub entry: Tensor<3>,
    /// Continues the backward pass in [`RolloutMode::Checkpointed`].
    pub trace: Option<Trace>,
}

/// The states of a rollout without a graph.
#[derive(Debug)]
pub struct Trace {
    /// The state before each step, without a graph.
    states: Vec<Tensor<3>>,
    path: TimestepPath,
    entry: Tensor<3>,
    strategy: Option<GradientCheckpointingStrategy>,
}

/// A state that gets a gradient. Its activation checkpointing is the network's, because operations
/// cannot mix settings.
fn tracked(state: Tensor<3>, strategy: Option<GradientCheckpointingStrategy>) -> Tensor<3> {
    let state = state.autodiff().require_grad();
    match strategy {
        Some(strategy) => state.with_gradient_checkpointing_strategy(strategy),
        None => state,
    }
}

/// The timesteps of a rollout of K = `steps` steps to the clean motion, one list of the batch per
/// step. Sample i begins at `starts[i]`; step k has timestep `floor(start (K - 1 - k) / (K - 1))`.
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
    /// Runs the steps of `timesteps` ([`rollout_timesteps`]) from `x_start_noise`. `plain` is
    /// `model` without gradients (Burn: `Module::valid`).
    ///
    /// # Shapes
    /// - x_start_noise: `[batch, channels, time]`, preferably on the device of `model`; detached
    ///
    /// # Errors
    /// Fails if the clipping bounds do not fit the channels, or the sizes of the network's output
    /// and input differ.
    pub fn run<D: Denoiser + ?Sized>(
        &self,
        model: &D,
        plain: &D,
        x_start_noise: Tensor<3>,
        cond: &D::Cond,
        timesteps: &[Vec<usize>],
        mode: RolloutMode,
    ) -> Result<RolloutOutput, Error> {
        let path = TimestepPath::to_clean(timesteps.to_vec());
        let graph_from = match mode {
            RolloutMode::Full => 0,
            RolloutMode::Checkpointed => path.num_steps(),
            RolloutMode::LastK(k) => path.num_steps().saturating_sub(k),
        };
        let strategy = x_start_noise.gradient_checkpointing_strategy();
        let mut states = Vec::new();
        let mut entry = None;
        let mut index = 0;
        let mut predict = |x: Tensor<3>, time: &[Time]| {
            let step = index;
            index += 1;
            if step < graph_from {
                if mode == RolloutMode::Checkpointed {
                    states.push(x.clone());
                }
                return self.predict(plain, x, time, cond);
            }
            let x = match step == graph_from {
                true => entry.insert(tracked(x, strategy)).clone(),
                false => self.decayed(x),
            };
            self.predict(model, x, time, cond)
        };
        let start = x_start_noise.without_autodiff();
        let x = self.walk(&mut predict, start, &path)?;
        // Without a graph, the backward pass ends at the final state.
        let entry = entry.unwrap_or_else(|| tracked(x.clone(), strategy));
        let trace = (mode == RolloutMode::Checkpointed).then(|| Trace {
            states,
            path,
            entry: entry.clone(),
            strategy,
        });
        let x = match graph_from < timesteps.len() {
            true => x,
            false => entry.clone(),
        };
        Ok(RolloutOutput { x, entry, trace })
    }

    /// The state with its gradient scaled by `gradient_decay`.
    fn decayed(&self, x: Tensor<3>) -> Tensor<3> {
        if self.gradient_decay == 1.0 {
            return x;
        }
        let value = x.clone().without_autodiff();
        value.clone() + (x - value) * self.gradient_decay
    }

    fn predict<D: Denoiser + ?Sized>(
        &self,
        network: &D,
        x: Tensor<3>,
        time: &[Time],
        cond: &D::Cond,
    ) -> Result<Prediction<'static>, Error> {
        let output = guided(network, x.clone(), time, cond, self.guidance);
        let timesteps = Time::timesteps(time);
        Prediction::new(&self.diffusion, output, x, &timesteps, &self.clip)
    }

    /// DDIM without noise.
    fn walk(
        &self,
        predict: &mut crate::Predict<'_, '_>,
        x: Tensor<3>,
        path: &TimestepPath,
    ) -> Result<Tensor<3>, Error> {
        let (diffusion, config) = (&self.diffusion, Ddim::default());
        let unused = Key::new(0, Purpose::Sampling).into();
        let mut on_step = |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
        ddim(diffusion, predict, x, path, &config, unused, &mut on_step)
    }
}

impl Trace {
    /// Continues the backward pass and returns the gradient of the start noise. Removes the
    /// gradient of the final state from `gradients`. Calls `each` with the index and gradients of
    /// each step, starting with the last step.
    ///
    /// # Errors
    /// The errors of [`Rollout::run`].
    pub fn backward<D: Denoiser + ?Sized>(
        mut self,
        rollout: &Rollout,
        model: &D,
        cond: &D::Cond,
        gradients: &mut Gradients,
        each: &mut dyn FnMut(usize, Gradients),
    ) -> Result<Tensor<3>, Error> {
        let mut cotangent = match self.entry.grad_remove(gradients) {
            Some(gradient) => gradient.without_autodiff(),
            None => self.entry.clone().without_autodiff().zeros_like(),
        };
        drop(self.entry);
        let mut predict = |x: Tensor<3>, time: &[Time]| rollout.predict(model, x, time, cond);
        for index in (0..self.path.num_steps()).rev() {
            let state = self.states.pop().expect("one state per step");
            let x = tracked(state, self.strategy);
            let y = rollout.walk(&mut predict, x.clone(), &self.path.step(index))?;
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
