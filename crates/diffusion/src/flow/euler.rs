use burn::tensor::Tensor;

use super::{Flowed, OnFlowStep, Velocity};
use crate::Error;
use crate::sampler::go_on;

/// Euler's method: `x += h v(x, t)` in `steps` equal steps of size h.
///
/// # Errors
/// Those of `velocity`, and [`Error::Stopped`].
pub fn euler<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    steps: usize,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    let mut x = x;
    let h = 1.0 / steps as f64;
    for step in 0..steps {
        let t = step as f64 * h;
        x = x.clone() + velocity(x, t)? * h;
        go_on(on_step((step + 1) as f64 * h, &x))?;
    }
    Ok(Flowed {
        x,
        evaluations: steps,
    })
}
