//! Heun's method.

use burn::tensor::Tensor;

use super::level::Level;
use super::path::TimestepPath;
use super::prediction::Predict;
use super::{OnStep, continue_or_stop};
use crate::ode::{Method, Ode};
use crate::per_sample::per_sample;
use crate::{Error, GaussianDiffusion, Time};

/// Samples by Heun's method along `path` (Karras et al. 2022, <https://arxiv.org/abs/2206.00364>,
/// algorithm 1). Each step calls the network twice. The step to the clean motion is Euler's and
/// calls the network once, because the slope at the end is undefined.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// The errors of `predict`. [`must_suit`](super::must_suit) rejects paths from pure noise (NaN).
pub fn heun(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    path: &TimestepPath,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    let mut x = x_T;
    for index in 0..path.num_steps() {
        let (now, prev_timesteps) = (path.timesteps(index), path.prev_timesteps(index));
        let end: Option<Vec<usize>> = prev_timesteps.iter().copied().collect();
        let method = match end {
            Some(_) => Method::HEUN,
            None => Method::EULER,
        };
        let mut step = Step {
            times: [Time::of(now), Time::of(&end.unwrap_or_default())],
            now: Level::of(diffusion, now.iter().copied().map(Some)),
            next: Level::of(diffusion, prev_timesteps),
            predict: &mut *predict,
        };
        x = method.step(&mut step, &x)?;
        continue_or_stop(on_step(index + 1, path.num_steps(), &x))?;
    }
    Ok(x)
}

/// A step of the probability flow of u = x / alpha, with the ratio r = sigma / alpha of the factors
/// of noise and motion in x_t:
///
/// ```text
/// du / dr = (u - x_0) / r
/// ```
struct Step<'a, 'p, 's> {
    predict: &'a mut Predict<'p, 's>,
    /// At both ends of the step.
    times: [Vec<Time>; 2],
    now: Vec<Level>,
    next: Vec<Level>,
}

impl Step<'_, '_, '_> {
    /// A factor of each sample from its levels at both ends.
    fn factor(&self, like: &Tensor<3>, value: impl Fn(&Level, &Level) -> f64) -> Tensor<3> {
        let levels = self.now.iter().zip(&self.next);
        let values: Vec<f64> = levels.map(|(now, next)| value(now, next)).collect();
        per_sample(&values, like)
    }
}

impl Ode<3> for Step<'_, '_, '_> {
    /// The x_t and x_0 of the slope.
    type Slope = (Tensor<3>, Tensor<3>);

    fn slope(&mut self, x: Tensor<3>, place: f64) -> Result<Self::Slope, Error> {
        let time = &self.times[usize::from(place > 0.0)];
        let prediction = (self.predict)(x, time)?;
        Ok((prediction.x_t, prediction.x_start))
    }

    fn moved(&self, _: &Tensor<3>, shares: &[f64], slopes: &[Self::Slope]) -> Tensor<3> {
        // The state at the start, possibly with a different gradient.
        let (x_t, x_start) = slopes[0].clone();
        if slopes.len() == 1 {
            // u' = u + (r' - r) (u - x_0) / r = (r' / r) u + (1 - r' / r) x_0.
            let of_x = self.factor(&x_t, |now, next| next.sigma / now.sigma);
            let of_x_start = self.factor(&x_start, |now, next| {
                next.alpha - now.alpha * next.sigma / now.sigma
            });
            return x_t * of_x + x_start * of_x_start;
        }
        // u' = u + (r' - r) sum(share (u_i - x_0_i) / r_i), with slopes at both ends.
        let of_x = self.factor(&x_t, |now, next| next.alpha / now.alpha);
        let ends: [fn(&Level, &Level) -> Level; 2] = [|now, _| *now, |_, next| *next];
        let terms = slopes.iter().zip(shares).zip(ends);
        terms.fold(x_t * of_x, |sum, (((x, x_start), share), end)| {
            let scale = |now: &Level, next: &Level| {
                share * next.alpha * (next.ratio() - now.ratio()) / end(now, next).ratio()
            };
            let of_x = self.factor(x, |now, next| scale(now, next) / end(now, next).alpha);
            let of_x_start = self.factor(x_start, scale);
            sum + (x.clone() * of_x - x_start.clone() * of_x_start)
        })
    }
}
