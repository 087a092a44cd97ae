use burn::tensor::Tensor;

use super::{Flowed, OnFlowStep, Velocity};
use crate::Error;
use crate::sampler::go_on;

/// Heun's method: a step of Euler's, then one along the mean of the velocities at both its ends, in
/// `steps` equal steps of size h.
///
/// # Errors
/// Those of `velocity`, and [`Error::Stopped`].
pub fn heun<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    steps: usize,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    let mut x = x;
    let h = 1.0 / steps as f64;
    for step in 0..steps {
        let first = velocity(x.clone(), step as f64 * h)?;
        let end = x.clone() + first.clone() * h;
        let second = velocity(end, (step + 1) as f64 * h)?;
        x = x + (first + second) * (h / 2.0);
        go_on(on_step((step + 1) as f64 * h, &x))?;
    }
    Ok(Flowed {
        x,
        evaluations: 2 * steps,
    })
}
