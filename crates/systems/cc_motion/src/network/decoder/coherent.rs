//! The projection of decoded motion onto coherent trajectories, with gradients.

use std::ops::Range;

use burn::tensor::{Tensor, TensorData};
use kinegrad_kernels::LinearMap;
use kinegrad_motion::coherence::{CoherentFit, EXTRA_FRAMES, coherent_matrix};
use kinegrad_motion::phrase::{ACCELERATION, POSITION, VELOCITY};

/// Axes of space.
const AXES: usize = 3;

/// The input channels of [`Fits`]: three estimates of the trajectory.
pub(super) const ESTIMATES: Range<usize> = POSITION.start..ACCELERATION.end;

/// Maps position, velocity and acceleration of motion of one length, `[9, frames]`, to the
/// positions of the nearest coherent trajectory, `[3, frames + 2]`.
#[derive(Debug)]
pub(super) struct Fits {
    scales: [[f64; 3]; AXES],
    fits: [CoherentFit; AXES],
}

impl Fits {
    /// The fits of `frames` frames, with the standard deviations `std` of all channels as scales.
    pub fn new(frames: usize, std: &[f64]) -> Self {
        let scales = [0, 1, 2].map(|axis| {
            [POSITION, VELOCITY, ACCELERATION].map(|component| std[component.start + axis])
        });
        Self {
            scales,
            fits: scales.map(|scales| CoherentFit::new(&vec![false; frames], scales)),
        }
    }
}

impl LinearMap for Fits {
    fn shape(&self, _: usize, frames: usize) -> [usize; 2] {
        [AXES, frames + EXTRA_FRAMES]
    }

    fn apply(&self, values: &[f32], mapped: &mut [f32]) {
        for (axis, fit) in self.fits.iter().enumerate() {
            let frames = fit.frames();
            let estimate = |component: usize| -> Vec<f64> {
                let values = &values[(component * AXES + axis) * frames..][..frames];
                values.iter().map(|value| f64::from(*value)).collect()
            };
            let estimates = [0, 1, 2].map(estimate);
            let positions = fit.positions([&estimates[0], &estimates[1], &estimates[2]]);
            let into = &mut mapped[axis * positions.len()..][..positions.len()];
            for (into, position) in into.iter_mut().zip(positions) {
                *into = position as f32;
            }
        }
    }

    fn adjoint(&self, gradient: &[f32], mapped: &mut [f32]) {
        for (axis, fit) in self.fits.iter().enumerate() {
            let frames = fit.frames();
            let extended = frames + EXTRA_FRAMES;
            let gradient = gradient[axis * extended..][..extended].iter();
            let estimates = fit.adjoint(gradient.map(|value| f64::from(*value)).collect());
            for (component, values) in estimates.into_iter().enumerate() {
                let into = &mut mapped[(component * AXES + axis) * frames..][..frames];
                for (into, value) in into.iter_mut().zip(values) {
                    *into = value as f32;
                }
            }
        }
    }

    /// One product with a dense matrix per axis.
    fn composed(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, _, time] = x.dims();
        let device = x.device();
        let scales: Vec<f32> = (0..9)
            .map(|channel| self.scales[channel % AXES][channel / AXES] as f32)
            .collect();
        let scales = Tensor::<3>::from_data(TensorData::new(scales, [1, 9, 1]), &device);
        // One column of estimates per sample and axis: [3, 3 time, batch].
        let estimates = (x / scales)
            .reshape([batch, 3, AXES, time])
            .permute([2, 1, 3, 0])
            .reshape([AXES, 3 * time, batch]);
        let matrices = self
            .scales
            .map(|scales| coherent_matrix(time, scales))
            .concat();
        let matrices = TensorData::new(matrices, [AXES, time + EXTRA_FRAMES, 3 * time]);
        let positions = Tensor::<3>::from_data(matrices, &device).matmul(estimates);
        positions.permute([2, 0, 1])
    }
}
