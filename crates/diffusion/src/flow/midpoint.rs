use burn::tensor::Tensor;

use super::{Flowed, OnFlowStep, Velocity};
use crate::Error;
use crate::sampler::go_on;

/// The midpoint method: `x += h v(x + h/2 v(x, t), t + h/2)` in `steps` equal steps of size h.
///
/// # Errors
/// Those of `velocity`, and [`Error::Stopped`].
pub fn midpoint<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    steps: usize,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    let mut x = x;
    let h = 1.0 / steps as f64;
    for step in 0..steps {
        let t = step as f64 * h;
        let first = velocity(x.clone(), t)?;
        let middle = x.clone() + first * (h / 2.0);
        x = x + velocity(middle, (step as f64 + 0.5) * h)? * h;
        go_on(on_step((step + 1) as f64 * h, &x))?;
    }
    Ok(Flowed {
        x,
        evaluations: 2 * steps,
    })
}
