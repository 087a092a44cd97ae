//! Conversion between the network's feature space and meters.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::humanml::Humanml3dConfig;
use kinegrad_diffusion::Space;
use kinegrad_kernels::float32_product;
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::goal::GROUND_X;
use kinegrad_motion::humanml::Features;

use crate::error::Error;

/// The linear map from the network's channels to the motion channels `rows`, centered:
/// `[rows, channels]`. The map inverts `projection` and normalization by `std`.
///
/// # Panics
/// Panics if a row or the projection does not fit the channels.
pub fn rows_to_motion(
    rows: &[usize],
    std: &[f64],
    projection: Option<&EmphasisProjection>,
) -> Vec<f32> {
    let channels = std.len();
    let inverse = projection.map(EmphasisProjection::inverse);
    let row = |&row: &usize| {
        (0..channels).map(move |channel| {
            let share = match inverse {
                Some(inverse) => f64::from(inverse[channel * channels + row]),
                None => f64::from(u8::from(channel == row)),
            };
            (share * std[row]) as f32
        })
    };
    rows.iter().flat_map(row).collect()
}

/// The affine map between the network's features and features in meters and radians, with an
/// optional projection P: `network = ((motion - mean) / std) P` (docs/sources.md, section 4.8).
#[derive(Clone, Debug)]
pub struct FeatureSpace {
    mean: Tensor<3>,
    std: Tensor<3>,
    /// The matrix and its inverse, transposed. The inverse of a published projection amplifies
    /// errors a thousand times, so both products are float32 on every device.
    projection: Option<[Tensor<2>; 2]>,
    /// Ground x and z of a frame, meters, from the network's channels: `[1, 2, channels]`.
    ground: Tensor<3>,
    /// Means of ground x and z: `[1, 2, 1]`.
    ground_mean: Tensor<3>,
}

impl FeatureSpace {
    /// The space of a network for features of this `mean` and `std`, one number per channel.
    ///
    /// # Panics
    /// Panics if the ground's channels are missing, or the projection does not fit.
    pub fn new(
        mean: &[f64],
        std: &[f64],
        projection: Option<&EmphasisProjection>,
        device: &Device,
    ) -> Self {
        let channels = mean.len();
        let ground_rows: Vec<usize> = (GROUND_X..GROUND_X + 2).collect();
        let ground_mean: Vec<f64> = ground_rows.iter().map(|&row| mean[row]).collect();
        let ground = rows_to_motion(&ground_rows, std, projection);
        let tensor = |values: &[f64], shape: [usize; 3]| -> Tensor<3> {
            let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            Tensor::from_data(TensorData::new(values, shape), device)
        };
        let square = |values: &[f32]| -> Tensor<2> {
            let data = TensorData::new(values.to_vec(), [channels, channels]);
            Tensor::<2>::from_data(data, device).transpose()
        };
        Self {
            ground: Tensor::from_data(TensorData::new(ground, [1, 2, channels]), device),
            ground_mean: tensor(&ground_mean, [1, 2, 1]),
            mean: tensor(mean, [1, channels, 1]),
            std: tensor(std, [1, channels, 1]),
            projection: projection.map(|p| [square(p.matrix()), square(p.inverse())]),
        }
    }

    /// Ground positions, meters, of motion in the network's space.
    ///
    /// # Shapes
    /// - x: `[batch, channels, time]`
    /// - output: `[batch, 2, time]`, x and z
    pub fn ground(&self, x: Tensor<3>) -> Tensor<3> {
        let ground = self.ground.clone().squeeze_dim::<2>(0);
        float32_product(ground, x) + self.ground_mean.clone()
    }

    /// The features of clips of `data` from motion in the network's space,
    /// `[batch, channels, time]`.
    ///
    /// # Errors
    /// [`Error::SampleNotFinite`] with the `name` of the first clip that is not finite.
    pub fn features(
        &self,
        x: Tensor<3>,
        data: &Humanml3dConfig,
        name: impl Fn(usize) -> String,
    ) -> Result<Vec<Features>, Error> {
        let [_, channels, frames] = x.dims();
        let rows = self.to_motion(x).swap_dims(1, 2);
        let values = rows.try_into_vec_as::<f32>().expect("samples are float32");
        let (layout, root) = (data.skeleton().layout(), data.root);
        let clips = values.chunks(channels * frames).enumerate();
        let features = clips.map(|(index, clip)| {
            if !clip.iter().all(|value| value.is_finite()) {
                let sample = name(index);
                return Err(Error::SampleNotFinite { sample });
            }
            Ok(Features::new(clip.to_vec(), layout, root)?)
        });
        features.collect()
    }

    /// Converts a gradient by ground positions to a gradient by the network's channels.
    ///
    /// # Shapes
    /// - gradient: `[batch, 2, time]`
    /// - output: `[batch, channels, time]`
    pub fn from_ground(&self, gradient: Tensor<3>) -> Tensor<3> {
        self.ground.clone().swap_dims(1, 2).matmul(gradient)
    }
}

impl Space for FeatureSpace {
    fn to_motion(&self, x: Tensor<3>) -> Tensor<3> {
        let normalized = match &self.projection {
            Some([_, inverse]) => float32_product(inverse.clone(), x),
            None => x,
        };
        normalized * self.std.clone() + self.mean.clone()
    }

    fn to_network(&self, motion: Tensor<3>) -> Tensor<3> {
        let normalized = (motion - self.mean.clone()) / self.std.clone();
        match &self.projection {
            Some([matrix, _]) => float32_product(matrix.clone(), normalized),
            None => normalized,
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_kernels::Mode;
    use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisKind};
    use kinegrad_random::{Key, Purpose};

    use super::*;

    #[test]
    fn projected_motion_returns_with_the_digits_that_tf32_loses() {
        // As published: Gaussian, with a condition number in the thousands.
        let (channels, frames) = (263, 30);
        let config = EmphasisConfig {
            kind: EmphasisKind::Gaussian,
            ..EmphasisConfig::default()
        };
        let projection = config.projection(channels).unwrap();
        let projection = projection.expect("a kind that projects");
        assert!(projection.condition_number() > 1000.0);
        let ones = vec![1.0; channels];
        let device = Device::flex();
        let space = FeatureSpace::new(&vec![0.0; channels], &ones, Some(&projection), &device);
        let motion = Key::new(5, Purpose::Synthetic).normals(channels * frames);
        let largest = |found: &[f32]| {
            let pairs = found.iter().zip(&motion);
            pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()))
        };
        for mode in [Mode::Fused, Mode::Composed] {
            let found = mode.scope(|| {
                let data = TensorData::new(motion.clone(), [1, channels, frames]);
                space.to_motion(space.to_network(Tensor::from_data(data, &device)))
            });
            let error = largest(&found.try_into_vec_as::<f32>().unwrap());
            assert!(error < 1e-3, "{mode:?}: {error}");
        }
        // TF32 products would give an error of several deviations.
        let tf32 = |value: f32| f32::from_bits((value.to_bits() + 0x1000) & !0x1fff);
        let times = |rows: &[f32], matrix: &[f32]| -> Vec<f32> {
            let mut out = vec![0.0; rows.len()];
            for (out, row) in out.chunks_mut(channels).zip(rows.chunks(channels)) {
                for (&value, weights) in row.iter().zip(matrix.chunks(channels)) {
                    let pairs = out.iter_mut().zip(weights);
                    pairs.for_each(|(out, &weight)| *out += tf32(value) * tf32(weight));
                }
            }
            out
        };
        // Frames are rows here; the order of the numbers does not matter.
        let there = times(&motion, projection.matrix());
        let error = largest(&times(&there, projection.inverse()));
        assert!(error > 0.05, "{error}");
    }
}
