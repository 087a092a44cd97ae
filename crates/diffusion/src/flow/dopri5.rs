//! The method of Dormand and Prince, of order 5 with an error estimate of order 4 (Hairer, Nørsett
//! and Wanner, "Solving Ordinary Differential Equations I", 1993, section II.5).

use burn::tensor::{DType, Tensor};

use super::{Flowed, OnFlowStep, Velocity};
use crate::Error;
use crate::sampler::go_on;

/// Where within a step each velocity but the first is asked for, and the shares of those before it
/// that lead there. The last is the step's end.
const STAGES: [(f64, &[f64]); 6] = [
    (1.0 / 5.0, &[1.0 / 5.0]),
    (3.0 / 10.0, &[3.0 / 40.0, 9.0 / 40.0]),
    (4.0 / 5.0, &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0]),
    (
        8.0 / 9.0,
        &[
            19372.0 / 6561.0,
            -25360.0 / 2187.0,
            64448.0 / 6561.0,
            -212.0 / 729.0,
        ],
    ),
    (
        1.0,
        &[
            9017.0 / 3168.0,
            -355.0 / 33.0,
            46732.0 / 5247.0,
            49.0 / 176.0,
            -5103.0 / 18656.0,
        ],
    ),
    (
        1.0,
        &[
            35.0 / 384.0,
            0.0,
            500.0 / 1113.0,
            125.0 / 192.0,
            -2187.0 / 6784.0,
            11.0 / 84.0,
        ],
    ),
];

/// Shares of all seven velocities in the difference of the two solutions.
const ERROR: [f64; 7] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339_200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// The shortest step that the adaptive solver takes.
const LEAST_STEP: f64 = 1e-6;

/// `x` and `h` times these shares of the velocities.
fn led<const D: usize>(x: &Tensor<D>, h: f64, shares: &[f64], slopes: &[Tensor<D>]) -> Tensor<D> {
    let parts = shares
        .iter()
        .zip(slopes)
        .filter(|(share, _)| **share != 0.0);
    parts.fold(x.clone(), |x, (share, slope)| {
        x + slope.clone() * (h * share)
    })
}

/// The end of a step of size `h` from `x` at `t`, with the velocities along the way, of which the
/// first is given. Asks for five.
fn step<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: &Tensor<D>,
    (t, h): (f64, f64),
    first: Tensor<D>,
) -> Result<(Tensor<D>, Vec<Tensor<D>>), Error> {
    let [inner @ .., (_, last)] = &STAGES;
    let mut slopes = vec![first];
    for (place, shares) in inner {
        let there = led(x, h, shares, &slopes);
        slopes.push(velocity(there, t + place * h)?);
    }
    Ok((led(x, h, last, &slopes), slopes))
}

/// The method of Dormand and Prince in `steps` equal steps, with six velocities each.
///
/// # Errors
/// Those of `velocity`, and [`Error::Stopped`].
pub fn dopri5<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    steps: usize,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    let mut x = x;
    let h = 1.0 / steps as f64;
    for index in 0..steps {
        let t = index as f64 * h;
        let first = velocity(x.clone(), t)?;
        (x, _) = step(velocity, &x, (t, h), first)?;
        go_on(on_step((index + 1) as f64 * h, &x))?;
    }
    Ok(Flowed {
        x,
        evaluations: 6 * steps,
    })
}

/// The method of Dormand and Prince with steps of its own choice: the estimated error of each is at
/// most `tolerance` in the root mean square over a sample's numbers, each measured by 1 or by its
/// own size if that is more, for every sample of the batch. All samples take the same steps, so
/// that a sample depends on what else is in its batch, within the tolerance.
///
/// Six velocities a step, taken or tried, and one at the start.
///
/// # Errors
/// Those of `velocity`, [`Error::Stopped`], [`Error::FlowTolerance`] where no step is short enough,
/// and [`Error::NotFinite`].
pub fn dopri5_adaptive<const D: usize>(
    velocity: &mut Velocity<'_, D>,
    x: Tensor<D>,
    tolerance: f64,
    on_step: &mut OnFlowStep<'_, D>,
) -> Result<Flowed<D>, Error> {
    let (mut x, mut t) = (x, 0.0);
    let mut h = tolerance.powf(0.2).min(1.0);
    let mut first = velocity(x.clone(), t)?;
    let mut evaluations = 1;
    while t < 1.0 {
        let last = t + h >= 1.0 - LEAST_STEP;
        let taken = if last { 1.0 - t } else { h };
        let (end, mut slopes) = step(velocity, &x, (t, taken), first.clone())?;
        let there = if last { 1.0 } else { t + taken };
        slopes.push(velocity(end.clone(), there)?);
        evaluations += 6;
        let apart = led(&x.zeros_like(), taken, &ERROR, &slopes);
        let size = x.clone().abs().max_pair(end.clone().abs()).clamp_min(1.0);
        let error = largest(apart / size) / tolerance;
        // 0.9, 0.2 and 5 as in the book, section II.4.
        let factor = match error {
            0.0 => 5.0,
            error => (0.9 * error.powf(-0.2)).clamp(0.2, 5.0),
        };
        if error <= 1.0 {
            (x, t) = (end, there);
            first = slopes.pop().expect("the velocity at the end");
            go_on(on_step(t, &x))?;
        } else if !error.is_finite() {
            return Err(Error::NotFinite);
        } else if taken <= LEAST_STEP {
            return Err(Error::FlowTolerance { tolerance, at: t });
        }
        h = (taken * factor).max(LEAST_STEP);
    }
    Ok(Flowed { x, evaluations })
}

/// The largest root mean square of a sample's numbers.
fn largest<const D: usize>(errors: Tensor<D>) -> f64 {
    let samples = errors.dims()[0];
    let values = errors.cast(DType::F64).into_data();
    let values = values.try_to_vec::<f64>().expect("float64");
    let of_sample = values.len() / samples.max(1);
    let mean_squares = values
        .chunks(of_sample.max(1))
        .map(|sample| sample.iter().map(|value| value * value).sum::<f64>() / sample.len() as f64);
    // Not `f64::max`, which passes over NaN: of any sample it stays.
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
    fn a_number_that_is_none_is_seen_in_any_sample() {
        for broken in 0..3 {
            let mut values = vec![0.1f32, 0.2, 0.3, 0.4, 0.5, 0.6];
            values[2 * broken] = f32::NAN;
            let errors = Tensor::<2>::from_data(TensorData::new(values, [3, 2]), &Device::flex());
            assert!(largest(errors).is_nan(), "sample {broken}");
        }
    }
}
