//! The projection of decoded orientations onto integrated angular velocities, with gradients.

use std::sync::Arc;

use burn::tensor::{Tensor, TensorData};
use kinegrad_kernels::{LinearMap, linear_map};
use kinegrad_motion::coherence::OrientationFit;

use super::LEAST_NORM;
use crate::network::channel_encoding::sign_continuous;
use crate::network::rotation::{conjugate, product, turned};

/// Fits orientations to unit quaternions and inconsistent angular velocities, as
/// [`fit_orientation`](kinegrad_motion::coherence::fit_orientation). Returns unit quaternions with
/// continuous signs. `std` are the training standard deviations of the angular velocity.
///
/// # Shapes
/// - quaternion: `[batch, 4, time]`
/// - rates: `[batch, 3, time]`, radians per second
/// - output: `[batch, 4, time]`
pub(super) fn fitted(quaternion: Tensor<3>, rates: Tensor<3>, std: &[f64]) -> Tensor<3> {
    let time = quaternion.dims()[2];
    let along = turned(rates);
    let rest = sign_continuous(product(conjugate(along.clone()), quaternion));
    let fit = Smooth(OrientationFit::new(vec![1.0; time], std));
    let rest = linear_map(rest, Arc::new(fit));
    let square = rest.clone().square().sum_dim(1);
    let rest = rest / (square + LEAST_NORM * LEAST_NORM).sqrt();
    sign_continuous(product(along, rest))
}

/// The separate fit of each channel, `[channels, frames]`.
#[derive(Debug)]
pub(super) struct Smooth(pub OrientationFit);

impl LinearMap for Smooth {
    fn shape(&self, channels: usize, frames: usize) -> [usize; 2] {
        [channels, frames]
    }

    fn apply(&self, values: &[f32], mapped: &mut [f32]) {
        let frames = self.0.frames();
        for (row, into) in values.chunks(frames).zip(mapped.chunks_mut(frames)) {
            let mut row: Vec<f64> = row.iter().map(|value| f64::from(*value)).collect();
            self.0.fit(&mut row);
            for (into, value) in into.iter_mut().zip(row) {
                *into = value as f32;
            }
        }
    }

    /// The matrix of the fit is symmetric.
    fn adjoint(&self, gradient: &[f32], mapped: &mut [f32]) {
        self.apply(gradient, mapped);
    }

    /// One product with a dense matrix.
    fn composed(&self, x: Tensor<3>) -> Tensor<3> {
        let frames = self.0.frames();
        let column = |t: usize| {
            let mut unit = vec![0.0; frames];
            unit[t] = 1.0;
            self.0.fit(&mut unit);
            unit.into_iter().map(|value| value as f32)
        };
        let matrix: Vec<f32> = (0..frames).flat_map(column).collect();
        let matrix = TensorData::new(matrix, [1, frames, frames]);
        let matrix = Tensor::<3>::from_data(matrix, &x.device());
        x.matmul(matrix)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use kinegrad_motion::Quaternion;
    use kinegrad_motion::coherence::fit_orientation;
    use kinegrad_motion::phrase::{ANGULAR_VELOCITY, CHANNELS};
    use kinegrad_random::{Key, Purpose};

    use super::super::tests::{assert_gradients, shaken, tensors};
    use super::*;

    #[test]
    fn it_is_the_fit_of_post_processing() {
        let device = Device::flex();
        for frames in [1, 2, 3, 61] {
            let motions = [shaken(1, frames), shaken(2, frames)];
            let [quaternion, rates] = tensors(&motions, &device);
            let found = fitted(quaternion, rates, &[0.7, 1.1, 0.9]);
            let found: Vec<f32> = found
                .swap_dims(1, 2)
                .into_data()
                .try_into_vec::<f32>()
                .unwrap();
            for (motion, rows) in motions.iter().zip(found.chunks(4 * frames)) {
                let mut expected = motion.clone();
                let mut std = [1.0; CHANNELS];
                std[ANGULAR_VELOCITY].copy_from_slice(&[0.7, 1.1, 0.9]);
                fit_orientation(&mut expected, &std, &vec![false; frames]);
                for (t, row) in rows.chunks(4).enumerate() {
                    let [w, x, y, z] = [0, 1, 2, 3].map(|i| f64::from(row[i]));
                    let dot = Quaternion::new(w, x, y, z)
                        .dot(expected.quaternion(t))
                        .abs();
                    assert!((dot - 1.0).abs() < 1e-5, "{frames} {t}: {dot}");
                }
            }
        }
    }

    #[test]
    fn gradients_reach_both_and_are_those_of_small_changes() {
        let frames = 9;
        let motions = [shaken(3, frames), shaken(4, frames)];
        let weights = Key::new(5, Purpose::Noise).normals(2 * 4 * frames);
        let loss = |quaternion: Tensor<3>, rates: Tensor<3>| {
            let weights = TensorData::new(weights.clone(), [2, 4, frames]);
            let weights = Tensor::<3>::from_data(weights, &quaternion.device());
            (fitted(quaternion, rates, &[0.9; 3]) * weights).sum()
        };
        assert_gradients(&motions, loss, 1e-2, |_| 2e-2);
    }
}
