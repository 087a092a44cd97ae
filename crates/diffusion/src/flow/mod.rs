//! Flow matching: a straight path from noise to data, and the solvers that follow its velocity.
//!
//! ```text
//! x_t = (1 - t) noise + t x_start      t = 0: noise, t = 1: data
//! v   = x_start - noise                dx / dt = v
//! ```
//!
//! As in Lipman et al. 2023, <https://arxiv.org/abs/2210.02747>, and Liu et al. 2023,
//! <https://arxiv.org/abs/2209.03003>, t runs opposite to the timesteps of
//! [`GaussianDiffusion`](crate::GaussianDiffusion). The papers' x_0 and x_1 are `noise` and
//! `x_start` here. Source: docs/sources.md, section 5.

mod process;
mod solver;

#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use burn::tensor::Tensor;

pub use process::{FlowPrediction, NEAREST_END};

use crate::error::check_output;
use crate::ode::Method;
use crate::sampler::{Dopri5, SamplerConfig, SamplerKind, must_suit_flow};
use crate::{Denoiser, Error, Time, guided};

/// The velocity of a state at a flow time.
pub type Velocity<'v, const D: usize> = dyn FnMut(Tensor<D>, f64) -> Result<Tensor<D>, Error> + 'v;

/// Callback after each step, with the flow time and the state. `Break` ends the solver with
/// [`Error::Stopped`].
pub type OnFlowStep<'a, const D: usize> = dyn FnMut(f64, &Tensor<D>) -> ControlFlow<()> + 'a;

/// The result of a solver.
#[derive(Clone, Debug)]
pub struct Flowed<const D: usize> {
    /// The state at t = 1, of the start's shape.
    pub x: Tensor<D>,
    /// Number of velocities computed. With guidance, each velocity calls the network twice.
    pub evaluations: usize,
}

/// Runs the solver of `config` from `x` at t = 0 to t = 1.
///
/// # Errors
/// Errors of the config and of `velocity`, and [`Error::Stopped`]. The adaptive solver also returns
/// [`Error::FlowTolerance`] and [`Error::NotFinite`].
pub fn integrate<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    config: &SamplerConfig,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    must_suit_flow(config)?;
    let mut evaluations = 0;
    let velocity: &mut Velocity<'_, D> = &mut |x, t| {
        evaluations += 1;
        velocity(x, t)
    };
    let method = match config.kind {
        SamplerKind::Midpoint => Method::MIDPOINT,
        SamplerKind::Heun(_) => Method::HEUN,
        SamplerKind::Dopri5(Dopri5 { tolerance: None }) => Method::DOPRI5,
        SamplerKind::Dopri5(Dopri5 {
            tolerance: Some(tolerance),
        }) => {
            let x = solver::adaptive_steps(velocity, x, tolerance, on_step)?;
            return Ok(Flowed { x, evaluations });
        }
        _ => Method::EULER,
    };
    let x = solver::equal_steps(&method, velocity, x, config.num_inference_steps, on_step)?;
    Ok(Flowed { x, evaluations })
}

/// Generates one pose or motion per sample of the start noise along a network's velocity.
///
/// The device and the network's weights must be plain, as for [`sample`](crate::sample). For
/// conversion to a velocity, t keeps a distance of [`NEAREST_END`] from 0 for predicted noise, and
/// from 1 for predicted data.
///
/// # Shapes
/// - noise, standard normal, and the result: `[batch, channels, time]`
/// - cond: the network's condition for the batch; [`Time`]s run from 0 to 1
///
/// # Errors
/// The errors of [`integrate`], and [`Error::ModelOutput`] if the sizes of the network's output and
/// input differ.
pub fn sample_flow<D: Denoiser + ?Sized>(
    denoiser: &D,
    noise: Tensor<3>,
    cond: &D::Cond,
    prediction: FlowPrediction,
    config: &SamplerConfig,
    on_step: &mut OnFlowStep<'_, 3>,
) -> Result<Flowed<3>, Error> {
    let [batch, ..] = noise.dims();
    let mut velocity = |x: Tensor<3>, t: f64| {
        let time = vec![Time(t); batch];
        let output = guided(denoiser, x.clone(), &time, cond, config.guidance_scale);
        check_output(&output, &x)?;
        let t = prediction.readable(t);
        Ok(prediction.convert(output, x, &vec![t; batch], FlowPrediction::Velocity))
    };
    integrate(&mut velocity, noise, config, on_step)
}
