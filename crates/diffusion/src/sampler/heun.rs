//! Heun's method.

use burn::tensor::Tensor;

use super::level::Level;
use super::{OnStep, Path, Predict, go_on};
use crate::per_sample::per_sample;
use crate::{Error, GaussianDiffusion, Time};

/// Samples by Heun's method along `path` (Karras et al. 2022, <https://arxiv.org/abs/2206.00364>,
/// algorithm 1): a step of Euler's method on the probability flow, then one along the mean of the
/// slopes at both its ends. Calls the network twice a step, and once in a step that lands on the
/// clean motion, where there is no slope.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// Those of `predict`. A path that begins in pure noise, without any motion, gives NaN;
/// [`must_suit`](super::must_suit) refuses it.
pub fn heun(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    path: &Path,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    // alpha, sigma   factors of motion and noise in x_t
    // r              noise over motion, sigma / alpha; the flow is that of u = x / alpha:
    //                du / dr = (u - x_0) / r
    let mut x = x_T;
    for index in 0..path.len() {
        let now = Level::of(diffusion, path.timesteps(index).iter().copied().map(Some));
        let landings = path.landings(index);
        let next = Level::of(diffusion, landings.iter().copied());
        let prediction = predict(x, &path.time(index))?;
        let (x_t, x_start) = (prediction.x_t, prediction.x_start);

        // 1. u' = u + (r' - r) (u - x_0) / r = (r' / r) u + (1 - r' / r) x_0.
        let of = |value: &dyn Fn(&Level, &Level) -> f64, like: &Tensor<3>| {
            let values: Vec<f64> = now.iter().zip(&next).map(|(a, b)| value(a, b)).collect();
            per_sample(&values, like)
        };
        let kept = of(&|now, next| next.sigma / now.sigma, &x_t);
        let gained = of(
            &|now, next| next.alpha - now.alpha * next.sigma / now.sigma,
            &x_start,
        );
        let euler = x_t.clone() * kept + x_start.clone() * gained;
        let Some(timesteps) = landings.into_iter().collect::<Option<Vec<usize>>>() else {
            x = euler;
            go_on(on_step(index + 1, path.len(), &x))?;
            continue;
        };

        // 2. u'' = u + (r' - r) / 2 ((u - x_0) / r + (u' - x_0') / r').
        let there = predict(euler, &Time::of(&timesteps))?;
        let slope = |x: Tensor<3>, x_start: Tensor<3>, level: &dyn Fn(&Level, &Level) -> Level| {
            // (x / alpha - x_0) / r, as alpha' (r' - r) / 2 of it is added.
            let half = |now: &Level, next: &Level| {
                next.alpha * (next.ratio() - now.ratio()) / (2.0 * level(now, next).ratio())
            };
            let of_x = of(&|now, next| half(now, next) / level(now, next).alpha, &x);
            let of_x_start = of(&half, &x_start);
            x * of_x - x_start * of_x_start
        };
        let first = slope(x_t.clone(), x_start, &|now, _| *now);
        let second = slope(there.x_t, there.x_start, &|_, next| *next);
        let carried = of(&|now, next| next.alpha / now.alpha, &x_t);
        x = x_t * carried + first + second;
        go_on(on_step(index + 1, path.len(), &x))?;
    }
    Ok(x)
}
