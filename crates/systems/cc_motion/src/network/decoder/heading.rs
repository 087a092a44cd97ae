//! The projection of decoded headings onto integrated angular velocities, with gradients.

use std::f64::consts::TAU;
use std::sync::Arc;

use burn::tensor::Tensor;
use kinegrad_kernels::linear_map;
use kinegrad_motion::coherence::{OrientationFit, UPRIGHT};
use kinegrad_motion::phrase::FPS;

use super::orientation::Smooth;
use crate::network::channel_encoding::turns;
use crate::network::rotation::{add_angle, product, step};

/// Squared length below which a direction is not normalized.
const LEAST_SQUARE: f64 = 1e-4;

/// Added to squared lengths before division.
const ROOT_EPS: f64 = 1e-12;

/// Fits headings to the given quaternions and angular velocities, as
/// [`fit_heading`](kinegrad_motion::coherence::fit_heading) with full confidence in all frames.
/// Returns unit quaternions turned about the vertical to the fitted headings, and angular
/// velocities turned with them. The gradient treats the whole turns of headings as constants. `std`
/// are the training standard deviations of the angular velocity.
///
/// # Shapes
/// - quaternion, first output: `[batch, 4, time]`
/// - rates, second output: `[batch, 3, time]`, radians per second
pub(super) fn fitted(
    quaternion: Tensor<3>,
    rates: Tensor<3>,
    std: &[f64],
) -> (Tensor<3>, Tensor<3>) {
    let time = quaternion.dims()[2];
    let fit = Arc::new(Smooth(OrientationFit::of_headings(vec![1.0; time], std[1])));
    let [rate_x, rate_y, rate_z] = [0, 1, 2].map(|axis| rates.clone().narrow(1, axis, 1));
    let heading = heading(quaternion.clone());
    let next = product(step(rates), quaternion.clone());
    let apart = from_to(heading.clone(), self::heading(next));
    let steps = nearest(turns(apart)) * TAU;
    let along = match time {
        1 => steps.zeros_like(),
        _ => {
            let sums = steps.clone().narrow(2, 0, time - 1).cumsum(2);
            Tensor::cat(vec![steps.clone().narrow(2, 0, 1).zeros_like(), sums], 2)
        }
    };
    let rest = turned_by(heading.clone(), along.clone().neg());
    // The smoothed direction determines the whole turns.
    let course = linear_map(rest.clone().without_autodiff(), fit.clone());
    let length = (course.clone().square().sum_dim(1) + ROOT_EPS).sqrt();
    let course = course / length;
    let places = turns(course.clone());
    let apart = turned_by(rest, places.clone() * -TAU);
    let smoothed = linear_map(unwrapped(places) + nearest(turns(apart)), fit) * TAU;

    let turned = along + smoothed;
    // Upside down, the heading and the axis of the tilt are undefined.
    let certainty = (upright(quaternion.clone()) / UPRIGHT).clamp_max(1.0);
    let places = turns(heading);
    let turn = nearest(turned / TAU - places.clone()) * certainty.clone();
    let headings = (places + turn.clone()) * TAU;
    let turn = turn * TAU;
    let half = turn.clone() / 2.0;
    let none = half.zeros_like();
    let about = Tensor::cat(vec![half.clone().cos(), none.clone(), half.sin(), none], 1);
    let quaternion = product(about, quaternion);

    let (sine, cosine) = (turn.clone().sin(), turn.cos());
    let x = rate_x.clone() * cosine.clone() + rate_z.clone() * sine.clone();
    let z = rate_z * cosine - rate_x * sine;
    let y = match time {
        1 => rate_y,
        _ => {
            let before = |x: Tensor<3>| x.narrow(2, 0, time - 1);
            let next = headings.clone().narrow(2, 1, time - 1);
            let more = nearest((next - before(headings) - before(steps)) / TAU) * TAU;
            let last = rate_y.clone().narrow(2, time - 1, 1);
            let changed = before(rate_y) + more * before(certainty) * FPS;
            Tensor::cat(vec![changed, last], 2)
        }
    };
    (quaternion, Tensor::cat(vec![x, y, z], 1))
}

/// The squared cosine of half the tilt, for quaternions of any norm, `[batch, 1, time]`.
fn upright(quaternion: Tensor<3>) -> Tensor<3> {
    let [w, y] = [0, 2].map(|part| quaternion.clone().narrow(1, part, 1));
    (w.square() + y.square()) / (quaternion.square().sum_dim(1) + LEAST_SQUARE)
}

/// Turns without whole turns, up to half a turn in either direction.
fn nearest(turns: Tensor<3>) -> Tensor<3> {
    let whole = turns.clone().without_autodiff().round();
    turns - whole
}

/// Sine and cosine of the heading, `[batch, 2, time]`: the turn about the vertical in quaternions
/// of any norm. The norm is small upside down, where the heading is undefined.
fn heading(quaternion: Tensor<3>) -> Tensor<3> {
    let [w, y] = [0, 2].map(|part| quaternion.clone().narrow(1, part, 1));
    let square = (w.clone().square() + y.clone().square()).clamp_min(LEAST_SQUARE);
    let sine = w.clone() * y.clone() * 2.0;
    Tensor::cat(vec![sine, w.square() - y.square()], 1) / square
}

/// Sine and cosine of the angle from the heading `from` to `to`, `[batch, 2, time]` each.
fn from_to(from: Tensor<3>, to: Tensor<3>) -> Tensor<3> {
    let [s, c] = [0, 1].map(|row| to.clone().narrow(1, row, 1));
    let [sine, cosine] = [0, 1].map(|row| from.clone().narrow(1, row, 1));
    let sin = s.clone() * cosine.clone() - c.clone() * sine.clone();
    Tensor::cat(vec![sin, c * cosine + s * sine], 1)
}

/// Sine and cosine of a direction turned by `angle`, `[batch, 1, time]`.
fn turned_by(direction: Tensor<3>, angle: Tensor<3>) -> Tensor<3> {
    add_angle(direction, angle.clone().sin(), angle.cos())
}

/// Angles in turns `[batch, 1, time]`, moved by whole turns to within half a turn of the previous
/// angle.
fn unwrapped(places: Tensor<3>) -> Tensor<3> {
    let time = places.dims()[2];
    if time < 2 {
        return places;
    }
    let next = places.clone().narrow(2, 1, time - 1);
    let steps = next - places.clone().narrow(2, 0, time - 1);
    let back = steps.round().neg().cumsum(2);
    let first = places.clone().narrow(2, 0, 1);
    Tensor::cat(vec![first, places.narrow(2, 1, time - 1) + back], 2)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_motion::coherence::fit_heading;
    use kinegrad_motion::phrase::{ANGULAR_VELOCITY, CHANNELS};
    use kinegrad_motion::{Phrase, Quaternion};
    use kinegrad_random::{Key, Purpose};

    use super::super::tests::{assert_gradients, shaken, tensors};
    use super::*;

    /// A leaning dancer with a heading that jumps in every seventh frame.
    fn jumping(seed: u64, frames: usize) -> Phrase {
        let mut motion = shaken(seed, frames);
        for t in (4..frames).step_by(7) {
            let turned = Quaternion::from_yaw(0.8) * motion.quaternion(t);
            motion.set_quaternion(t, turned);
        }
        motion
    }

    #[test]
    fn it_is_the_fit_of_post_processing() {
        let rates = [0.7, 1.1, 0.9];
        for frames in [1, 2, 3, 61] {
            let motions = [jumping(1, frames), shaken(2, frames)];
            let [quaternion, turning] = tensors(&motions, &Device::flex());
            let (found, turning) = fitted(quaternion, turning, &rates);
            let rows = |x: Tensor<3>| x.swap_dims(1, 2).into_data().try_into_vec::<f32>().unwrap();
            let (found, turning) = (rows(found), rows(turning));
            for (item, motion) in motions.iter().enumerate() {
                let mut expected = motion.clone();
                let mut std = [1.0; CHANNELS];
                std[ANGULAR_VELOCITY].copy_from_slice(&rates);
                fit_heading(
                    &mut expected,
                    &std,
                    &vec![false; frames],
                    &vec![1.0; frames],
                );
                for t in 0..frames {
                    let place = item * frames + t;
                    let [w, x, y, z] = [0, 1, 2, 3].map(|i| f64::from(found[4 * place + i]));
                    let found = Quaternion::new(w, x, y, z);
                    let dot = found.dot(expected.quaternion(t)).abs();
                    assert!((dot - 1.0).abs() < 1e-5, "{frames} {item} {t}: {dot}");
                    let wanted = expected.vector(t, ANGULAR_VELOCITY);
                    for axis in 0..3 {
                        let found = f64::from(turning[3 * place + axis]);
                        assert!(
                            (found - wanted[axis]).abs() < 1e-3,
                            "{frames} {item} {t} {axis}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn gradients_reach_both_and_are_those_of_small_changes() {
        let frames = 9;
        let motions = [jumping(3, frames), shaken(4, frames)];
        let weights = Key::new(5, Purpose::Noise).normals(2 * 7 * frames);
        let loss = |quaternion: Tensor<3>, rates: Tensor<3>| {
            let weights = TensorData::new(weights.clone(), [2, 7, frames]);
            let weights = Tensor::<3>::from_data(weights, &quaternion.device());
            let (quaternion, rates) = fitted(quaternion, rates, &[0.9; 3]);
            // q and -q are the same rotation.
            (Tensor::cat(vec![quaternion.square(), rates], 1) * weights).sum()
        };
        assert_gradients(&motions, loss, 2e-3, |expected| {
            2e-2 * expected.abs().max(1.0)
        });
    }
}
