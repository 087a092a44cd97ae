//! Steps along a velocity from t = 0 to t = 1.

use burn::tensor::{DType, Tensor};

use super::{OnFlowStep, Velocity};
use crate::Error;
use crate::ode::{Method, Ode};
use crate::sampler::continue_or_stop;

/// A step of size `h`; `time` maps places in the step to flow times.
struct FlowStep<'a, 'v, T, const D: usize> {
    velocity: &'a mut Velocity<'v, D>,
    time: T,
    h: f64,
}

impl<T: Fn(f64) -> f64, const D: usize> Ode<D> for FlowStep<'_, '_, T, D> {
    type Slope = Tensor<D>;

    fn slope(&mut self, x: Tensor<D>, place: f64) -> Result<Tensor<D>, Error> {
        (self.velocity)(x, (self.time)(place))
    }

    fn moved(&self, x: &Tensor<D>, shares: &[f64], slopes: &[Tensor<D>]) -> Tensor<D> {
        let terms = shares.iter().zip(slopes);
        let terms: Vec<_> = terms.filter(|(share, _)| **share != 0.0).collect();
        // Adding slopes of equal shares before scaling saves a product.
        let equal = terms.chunk_by(|a, b| a.0 == b.0);
        equal.fold(x.clone(), |x, terms| {
            let slopes = terms.iter().map(|(_, slope)| (*slope).clone());
            let sum = slopes.reduce(|sum, slope| sum + slope).expect("a term");
            x + sum * (self.h * terms[0].0)
        })
    }
}

/// `steps` equal steps of `method`.
///
/// # Errors
/// The errors of `velocity`, and [`Error::Stopped`].
pub(super) fn equal_steps<const D: usize>(
    method: &Method,
    velocity: &mut Velocity<'_, D>,
    mut x: Tensor<D>,
    steps: usize,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Tensor<D>, Error> {
    let h = 1.0 / steps as f64;
    for step in 0..steps {
        let start = step as f64;
        // The formulas round differently; the sample of a seed depends on that rounding.
        let time = |place: f64| match method.evaluations() {
            1 | 2 => (start + place) * h,
            _ => start * h + place * h,
        };
        x = method.step(&mut FlowStep { velocity, time, h }, &x)?;
        continue_or_stop(on_step((start + 1.0) * h, &x))?;
    }
    Ok(x)
}

/// The shortest step of the adaptive solver.
const LEAST_STEP: f64 = 1e-6;

/// Steps of [`Method::DOPRI5`] with adaptive size. For every sample, the estimated error of a step
/// is at most `tolerance`. The error is the root mean square over the sample's values, relative for
/// values above 1. All samples of a batch take the same steps, so a sample depends on the others
/// within the tolerance.
///
/// The velocity is computed once at the start and six times per accepted or rejected step.
///
/// # Errors
/// The errors of `velocity`, [`Error::Stopped`], [`Error::FlowTolerance`] if no step is short
/// enough, and [`Error::NotFinite`].
pub(super) fn adaptive_steps<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    mut x: Tensor<D>,
    tolerance: f64,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Tensor<D>, Error> {
    let mut t = 0.0;
    let mut h = tolerance.powf(0.2).min(1.0);
    let mut first = velocity(x.clone(), t)?;
    while t < 1.0 {
        let last = t + h >= 1.0 - LEAST_STEP;
        let h_taken = if last { 1.0 - t } else { h };
        let t_end = if last { 1.0 } else { t + h_taken };
        let mut step = FlowStep {
            velocity,
            time: |place: f64| t + place * h_taken,
            h: h_taken,
        };
        let (end, mut slopes) = Method::DOPRI5.step_along(&mut step, &x, first.clone())?;
        slopes.push((step.velocity)(end.clone(), t_end)?);
        let difference = step.moved(&x.zeros_like(), &Method::DOPRI5_ERROR, &slopes);
        let size = x.clone().abs().max_pair(end.clone().abs()).clamp_min(1.0);
        let error = largest(difference / size) / tolerance;
        // 0.9, 0.2 and 5 are from Hairer et al., section II.4.
        let factor = match error {
            0.0 => 5.0,
            error => (0.9 * error.powf(-0.2)).clamp(0.2, 5.0),
        };
        if error <= 1.0 {
            (x, t) = (end, t_end);
            first = slopes.pop().expect("the velocity at the end");
            continue_or_stop(on_step(t, &x))?;
        } else if !error.is_finite() {
            return Err(Error::NotFinite);
        } else if h_taken <= LEAST_STEP {
            return Err(Error::FlowTolerance { tolerance, at: t });
        }
        h = (h_taken * factor).max(LEAST_STEP);
    }
    Ok(x)
}

/// The largest root mean square of a sample's values.
fn largest<const D: usize>(errors: Tensor<D>) -> f64 {
    let samples = errors.dims()[0];
    let values = errors.cast(DType::F64).into_data();
    let values = values.try_to_vec::<f64>().expect("float64");
    let of_sample = values.len() / samples.max(1);
    let mean_squares = values
        .chunks(of_sample.max(1))
        .map(|sample| sample.iter().map(|value| value * value).sum::<f64>() / sample.len() as f64);
    // Unlike `f64::max`, this comparison keeps NaN.
    let worst = mean_squares.fold(0.0, |worst: f64, next| {
        match worst.is_nan() || next <= worst {
            true => worst,
            false => next,
        }
    });
    worst.sqrt()
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn nan_is_found_in_any_sample() {
        for broken in 0..3 {
            let mut values = vec![0.1f32, 0.2, 0.3, 0.4, 0.5, 0.6];
            values[2 * broken] = f32::NAN;
            let errors = Tensor::<2>::from_data(TensorData::new(values, [3, 2]), &Device::flex());
            assert!(largest(errors).is_nan(), "sample {broken}");
        }
    }
}
