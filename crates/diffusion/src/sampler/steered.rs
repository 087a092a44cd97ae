//! Guidance and imputation within a step of DDPM.

use burn::tensor::Tensor;

use super::imputation::Imputation;
use super::posterior::Posterior;
use crate::per_sample::per_sample;
use crate::{GaussianDiffusion, PredictionType};

/// Guidance and imputation of one step of DDPM.
pub struct Steered<'a> {
    /// `s d(-L) / d x_t` of a guided step.
    pub scaled_gradient: Option<Tensor<3>>,
    /// [`Guidance::max_shift`](crate::Guidance::max_shift).
    pub max_shift: Option<f64>,
    /// The known values.
    pub imputation: Option<Imputation<'a>>,
}

impl Steered<'_> {
    /// The steered mean; `unguided` is the mean without steering.
    pub(crate) fn mean(
        &self,
        diffusion: &GaussianDiffusion,
        unguided: Tensor<3>,
        x_start: &Tensor<3>,
        x_t: Tensor<3>,
        posterior: &Posterior,
    ) -> Tensor<3> {
        let guided = self.scaled_gradient.as_ref().map(|gradient| {
            let variance = per_sample(&posterior.variance, &x_t);
            let shift = gradient.clone() * variance.clone();
            let shift = match self.max_shift {
                Some(most) => limited(shift, variance.sqrt() * most),
                None => shift,
            };
            unguided.clone() + shift
        });
        match &self.imputation {
            Some(imputation) if predicts_motion(diffusion) => {
                let imputed = posterior.mean(imputation.put_into(x_start.clone()), x_t);
                match guided {
                    Some(guided) => imputation.merge(imputed, guided),
                    // Outside the mask both means are the same.
                    None => imputed,
                }
            }
            _ => guided.unwrap_or(unguided),
        }
    }

    /// `sample`, the result of the step. If the network predicts noise, the result contains the
    /// known values.
    pub(crate) fn impute(
        &self,
        diffusion: &GaussianDiffusion,
        sample: Tensor<3>,
        x_start: Tensor<3>,
        prev_timesteps: &[Option<usize>],
        imputation_noise: Option<Tensor<3>>,
    ) -> Tensor<3> {
        let Some(imputation) = self.imputation.as_ref() else {
            return sample;
        };
        if predicts_motion(diffusion) {
            return sample;
        }
        let known = imputation.put_into(x_start);
        let noised = match imputation_noise {
            Some(noise) => {
                // As in the published program, timestep 0 is the lowest noise level.
                let levels: Vec<usize> = prev_timesteps.iter().map(|t| t.unwrap_or(0)).collect();
                diffusion.add_noise(known, noise, &levels)
            }
            None => known,
        };
        imputation.merge(noised, sample)
    }
}

/// `shift` with the norm of each frame (over channels) limited to `most`, `[batch, 1, 1]`.
fn limited(shift: Tensor<3>, most: Tensor<3>) -> Tensor<3> {
    // Scaling first prevents an overflow of squares of large shifts. A shift of zero stays zero.
    let largest = shift.clone().abs().max_dim(1).clamp_min(f32::MIN_POSITIVE);
    let direction = shift / largest.clone();
    let length = direction.clone().square().sum_dim(1).sqrt();
    let limit = most / length.clamp_min(f32::MIN_POSITIVE);
    direction * largest.min_pair(limit)
}

fn predicts_motion(diffusion: &GaussianDiffusion) -> bool {
    diffusion.config.prediction_type == PredictionType::Sample
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn limited_shifts_keep_their_direction() {
        let tensor = |values: &[f32], shape: [usize; 3]| -> Tensor<3> {
            Tensor::from_data(TensorData::new(values.to_vec(), shape), &Device::flex())
        };
        // Three frames of two channels, of norm 5, 0.5 and 0.
        let shift = tensor(&[3.0, 0.3, 0.0, 4.0, 0.4, 0.0], [1, 2, 3]);
        let found = limited(shift, tensor(&[1.0], [1, 1, 1]));
        let found = found.try_into_vec_as::<f32>().unwrap();
        for (found, expected) in found.iter().zip([0.6, 0.3, 0.0, 0.8, 0.4, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
        let away = limited(tensor(&[3e30, 4e30], [1, 2, 1]), tensor(&[1.0], [1, 1, 1]));
        let away = away.try_into_vec_as::<f32>().unwrap();
        assert!((away[0] - 0.6).abs() < 1e-6 && (away[1] - 0.8).abs() < 1e-6);
    }
}
