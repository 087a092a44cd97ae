//! Conversion between the network's feature space and metres.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Objective, Space};
use kinegrad_models::gmd::times;
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::goal::{GROUND_X, GuidanceLoss};

/// The affine map between normalised, perhaps projected features and features in metres and
/// radians: `network = ((motion - mean) / std) P` (docs/sources.md, section 4.8).
#[derive(Clone, Debug)]
pub struct FeatureSpace {
    mean: Tensor<3>,
    std: Tensor<3>,
    /// The matrix and its inverse.
    projection: Option<[Tensor<2>; 2]>,
    /// Ground x and z of a frame in metres from the network's channels: `[1, 2, channels]`.
    ground: Tensor<3>,
    /// What they begin at: `[1, 2, 1]`.
    ground_mean: Tensor<3>,
}

impl FeatureSpace {
    /// The space of a network for features of this `mean` and `std`, one number a channel.
    ///
    /// # Panics
    /// Panics if there are fewer than the ground's channels, or the projection has others.
    pub fn new(
        mean: &[f64],
        std: &[f64],
        projection: Option<&EmphasisProjection>,
        device: &Device,
    ) -> Self {
        let channels = mean.len();
        let ground_rows = GROUND_X..GROUND_X + 2;
        let inverse = projection.map(EmphasisProjection::inverse);
        let ground: Vec<f64> = ground_rows
            .clone()
            .flat_map(|row| {
                (0..channels).map(move |channel| {
                    let share = match inverse {
                        Some(inverse) => f64::from(inverse[channel * channels + row]),
                        None => f64::from(u8::from(channel == row)),
                    };
                    share * std[row]
                })
            })
            .collect();
        let tensor = |values: &[f64], shape: [usize; 3]| -> Tensor<3> {
            let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            Tensor::from_data(TensorData::new(values, shape), device)
        };
        let square = |values: &[f32]| -> Tensor<2> {
            let data = TensorData::new(values.to_vec(), [channels, channels]);
            Tensor::from_data(data, device)
        };
        Self {
            ground: tensor(&ground, [1, 2, channels]),
            ground_mean: tensor(&mean[ground_rows], [1, 2, 1]),
            mean: tensor(mean, [1, channels, 1]),
            std: tensor(std, [1, channels, 1]),
            projection: projection.map(|p| [square(p.matrix()), square(p.inverse())]),
        }
    }

    /// Ground positions in metres of motion in the network's space.
    ///
    /// # Shapes
    /// - x: `[batch, channels, time]`
    /// - output: `[batch, 2, time]`, x and z
    pub fn ground(&self, x: Tensor<3>) -> Tensor<3> {
        self.ground.clone().matmul(x) + self.ground_mean.clone()
    }
}

impl Space for FeatureSpace {
    fn to_motion(&self, x: Tensor<3>) -> Tensor<3> {
        let normalized = match &self.projection {
            Some([_, inverse]) => times(x, inverse.clone()),
            None => x,
        };
        normalized * self.std.clone() + self.mean.clone()
    }

    fn to_network(&self, motion: Tensor<3>) -> Tensor<3> {
        let normalized = (motion - self.mean.clone()) / self.std.clone();
        match &self.projection {
            Some([matrix, _]) => times(normalized, matrix.clone()),
            None => normalized,
        }
    }
}

/// The guidance loss of the root's ground path.
#[derive(Clone, Debug)]
pub struct GroundObjective<'a> {
    /// Where the network works.
    pub space: &'a FeatureSpace,
    /// What the path is measured by.
    pub loss: GuidanceLoss,
}

impl Objective for GroundObjective<'_> {
    fn gradient(&self, pred_original_sample: &Tensor<3>) -> Tensor<3> {
        let [batch, _, time] = pred_original_sample.dims();
        let positions = self
            .space
            .ground(pred_original_sample.clone())
            .swap_dims(1, 2);
        let positions = positions.try_into_vec_as::<f32>();
        let positions = positions.expect("samples are float32").into_iter();
        let positions: Vec<f64> = positions.map(f64::from).collect();
        // On the host and in double precision: a few thousand numbers, and obstacles branch.
        let (_, gradient) = self.loss.evaluate(&positions);
        let gradient: Vec<f32> = gradient.into_iter().map(|value| value as f32).collect();
        let device = pred_original_sample.device();
        let data = TensorData::new(gradient, [batch, time, 2]);
        let gradient = Tensor::<3>::from_data(data, &device).swap_dims(1, 2);
        self.space.ground.clone().swap_dims(1, 2).matmul(gradient)
    }
}
