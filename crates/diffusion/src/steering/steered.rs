//! What leads a step of DDPM to a goal.

use burn::tensor::Tensor;

use super::Imputation;
use crate::per_sample::per_sample;
use crate::sampler::Posterior;
use crate::{GaussianDiffusion, PredictionType};

/// What leads a step of DDPM to a goal.
pub struct Steered<'a> {
    /// `s d(-L) / d x_t`, where the step is guided.
    pub scaled_gradient: Option<Tensor<3>>,
    /// The values that are put in.
    pub imputation: Option<Imputation<'a>>,
}

impl Steered<'_> {
    /// The mean of the step, whose mean without steering is `unguided`.
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
            unguided.clone() + gradient.clone() * variance
        });
        match &self.imputation {
            Some(imputation) if predicts_motion(diffusion) => {
                let imputed = posterior.mean(imputation.put_into(x_start.clone()), x_t);
                match guided {
                    Some(guided) => imputation.merge(imputed, guided),
                    // Outside the mask both means are the same: the map back and forth only rounds.
                    None => imputed,
                }
            }
            _ => guided.unwrap_or(unguided),
        }
    }

    /// Where the step that produced `sample` lands.
    pub(crate) fn landed(
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
                // The published program goes no lower than the least noisy timestep.
                let levels: Vec<usize> = prev_timesteps.iter().map(|t| t.unwrap_or(0)).collect();
                diffusion.add_noise(known, noise, &levels)
            }
            None => known,
        };
        imputation.merge(noised, sample)
    }
}

fn predicts_motion(diffusion: &GaussianDiffusion) -> bool {
    diffusion.config.prediction_type == PredictionType::Sample
}
