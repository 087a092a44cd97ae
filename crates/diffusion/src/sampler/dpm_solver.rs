//! DPM-Solver++ of second order.

use burn::tensor::Tensor;

use super::level::Level;
use super::path::TimestepPath;
use super::prediction::Predict;
use super::{OnStep, continue_or_stop};
use crate::per_sample::per_sample;
use crate::{Error, GaussianDiffusion};

/// Smallest number of steps with a last step of second order. Otherwise the last step would
/// overshoot (diffusers' `lower_order_final`). Steps to the clean motion are of first order.
const STEPS_OF_SECOND_ORDER: usize = 15;

/// Samples by DPM-Solver++(2M) along `path` (Lu et al. 2022, <https://arxiv.org/abs/2211.01095>,
/// algorithm 2), a method of second order with one network call per step.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// The errors of `predict`.
pub fn dpmpp_2m(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    path: &TimestepPath,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    // alpha, sigma   factors of motion and noise in x_t; lambda = ln(alpha / sigma)
    // h              growth of lambda over the step; infinite if it ends at the clean motion
    // D              predicted clean motion, corrected by its change since the last step
    let mut x = x_T;
    let mut before: Option<(Tensor<3>, Vec<Level>)> = None;
    for index in 0..path.num_steps() {
        let now = Level::of(diffusion, path.timesteps(index).iter().copied().map(Some));
        let next = Level::of(diffusion, path.prev_timesteps(index));
        let prediction = predict(x, &path.time(index))?;
        let (x_t, x_start) = (prediction.x_t, prediction.x_start);

        // 1. D = x_0 + (h / 2 h_before) (x_0 - x_0 before), of first order in the first step and in
        //    a last one that would overshoot.
        let last = index + 1 == path.num_steps();
        let second_order = !last || path.num_steps() >= STEPS_OF_SECOND_ORDER;
        let corrected = match &before {
            Some((x_start_before, then)) if second_order => {
                let share = |sample: usize| {
                    let h = now[sample].lambda_to(&next[sample]);
                    let h_before = then[sample].lambda_to(&now[sample]);
                    match h.is_finite() {
                        true => 0.5 * h / h_before,
                        false => 0.0,
                    }
                };
                let shares: Vec<f64> = (0..now.len()).map(share).collect();
                let difference = x_start.clone() - x_start_before.clone();
                let shares = per_sample(&shares, &difference);
                x_start.clone() + difference * shares
            }
            _ => x_start.clone(),
        };

        // 2. x' = (sigma' / sigma) x + alpha' (1 - e^-h) D,  e^-h = (alpha sigma') / (sigma
        //    alpha').
        let levels = || now.iter().zip(&next);
        let of_x: Vec<f64> = levels().map(|(now, next)| next.sigma / now.sigma).collect();
        let of_x_start: Vec<f64> = levels()
            .map(|(now, next)| next.alpha - now.alpha * next.sigma / now.sigma)
            .collect();
        let (of_x, of_x_start) = (per_sample(&of_x, &x_t), per_sample(&of_x_start, &corrected));
        x = x_t * of_x + corrected * of_x_start;
        before = Some((x_start, now));
        continue_or_stop(on_step(index + 1, path.num_steps(), &x))?;
    }
    Ok(x)
}
