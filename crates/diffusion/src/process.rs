//! The forward process, the training target, and conversions between prediction types.

use burn::tensor::Tensor;
use kinegrad_settings::InvalidSetting;

use crate::per_sample::per_sample;
use crate::{DiffusionConfig, NoiseSchedule, PredictionType};

/// Gaussian diffusion (CC-MotionGen, sections 3.2 and 5; docs/sources.md, section 1.3; Ho et al.
/// 2020, <https://arxiv.org/abs/2006.11239>).
///
/// Motions, noises and model outputs are `[batch, channels, time]`; `timesteps` has one entry per
/// sample. With `a = sqrt(abar_t)` and `s = sqrt(1 - abar_t)`:
///
/// ```text
/// x_t = a x_start + s noise            epsilon        noise
///                                      sample         x_start
///                                      v_prediction   v = a noise - s x_start
/// ```
///
/// # Panics
/// Every method panics unless there is one timestep per sample and all timesteps are below
/// `num_train_timesteps`.
#[derive(Clone, Debug)]
pub struct GaussianDiffusion {
    /// The tables.
    pub schedule: NoiseSchedule,
    /// The settings.
    pub config: DiffusionConfig,
}

impl GaussianDiffusion {
    /// The process of `config`.
    ///
    /// # Errors
    /// Fails if the config is not valid ([`DiffusionConfig::validate`]).
    pub fn new(config: &DiffusionConfig) -> Result<Self, InvalidSetting> {
        Ok(Self {
            schedule: NoiseSchedule::new(config)?,
            config: config.clone(),
        })
    }

    /// `x_t = a x_start + s noise`, the paper's q_sample (sections 3.2.3 and 5.1).
    ///
    /// # Shapes
    /// - x_start, noise, output: `[batch, channels, time]`
    pub fn add_noise(
        &self,
        x_start: Tensor<3>,
        noise: Tensor<3>,
        timesteps: &[usize],
    ) -> Tensor<3> {
        let (a, s) = self.signal_and_noise(timesteps, &x_start);
        x_start * a + noise * s
    }

    /// The training target of the network for `add_noise(x_start, noise, timesteps)`, by
    /// `config.prediction_type`.
    ///
    /// # Shapes
    /// - x_start, noise, output: `[batch, channels, time]`
    pub fn target(&self, x_start: Tensor<3>, noise: Tensor<3>, timesteps: &[usize]) -> Tensor<3> {
        match self.config.prediction_type {
            PredictionType::Epsilon => noise,
            PredictionType::Sample => x_start,
            PredictionType::VPrediction => {
                let (a, s) = self.signal_and_noise(timesteps, &x_start);
                noise * a - x_start * s
            }
        }
    }

    /// The unclipped clean motion of a model output.
    ///
    /// # Shapes
    /// - model_output, x_t, output: `[batch, channels, time]`
    pub fn pred_original_sample(
        &self,
        model_output: Tensor<3>,
        x_t: Tensor<3>,
        timesteps: &[usize],
    ) -> Tensor<3> {
        let from = self.config.prediction_type;
        self.convert(model_output, x_t, timesteps, from, PredictionType::Sample)
    }

    /// Converts a prediction from one type to another for the same `x_t`, by an affine map.
    ///
    /// If the last timestep is pure noise (`rescale_betas_zero_snr`), predicted noise does not
    /// determine the motion there and the result is not finite.
    ///
    /// # Shapes
    /// - prediction, x_t, output: `[batch, channels, time]`
    pub fn convert(
        &self,
        prediction: Tensor<3>,
        x_t: Tensor<3>,
        timesteps: &[usize],
        from: PredictionType,
        to: PredictionType,
    ) -> Tensor<3> {
        use PredictionType::{Epsilon, Sample, VPrediction};
        if from == to {
            return prediction;
        }
        let (a, s) = self.signal_and_noise(timesteps, &x_t);
        match (from, to) {
            (Epsilon, Sample) => (x_t - prediction * s) / a,
            (Epsilon, _) => (prediction - x_t * s) / a,
            (Sample, Epsilon) => (x_t - prediction * a) / s,
            (Sample, _) => (x_t * a - prediction) / s,
            (VPrediction, Sample) => x_t * a - prediction * s,
            (VPrediction, _) => prediction * a + x_t * s,
        }
    }

    /// Mean and variance of `q(x_{t-1} | x_t, x_start)` (section 3.2.4; Ho et al. 2020, equation
    /// 7): `mean = coef1 x_start + coef2 x_t`. The variance is 0 at t = 0.
    ///
    /// # Shapes
    /// - x_start, x_t, mean: `[batch, channels, time]`
    /// - variance: one per sample
    pub fn posterior(
        &self,
        x_start: Tensor<3>,
        x_t: Tensor<3>,
        timesteps: &[usize],
    ) -> (Tensor<3>, Vec<f64>) {
        let schedule = &self.schedule;
        let coef1 = per_sample(&at(&schedule.posterior_mean_coef1, timesteps), &x_start);
        let coef2 = per_sample(&at(&schedule.posterior_mean_coef2, timesteps), &x_t);
        let variance = at(&schedule.posterior_variance, timesteps);
        (x_start * coef1 + x_t * coef2, variance)
    }

    /// The loss weight of each sample. The weight is 1 without `config.snr_gamma`, and otherwise
    /// the min-SNR weight of the sample's timestep (Hang et al. 2023,
    /// <https://arxiv.org/abs/2303.09556>, section 3.4), with `c = min(snr, snr_gamma)`:
    ///
    /// ```text
    /// epsilon  c / snr        sample  c        v_prediction  c / (snr + 1)
    /// ```
    ///
    /// All three weigh the error of the clean motion equally.
    pub fn loss_weights(&self, timesteps: &[usize]) -> Vec<f64> {
        let Some(snr_gamma) = self.config.snr_gamma else {
            return vec![1.0; timesteps.len()];
        };
        let weight = |&t: &usize| {
            let snr = self.schedule.snr(t);
            let capped = snr.min(snr_gamma);
            match self.config.prediction_type {
                PredictionType::Epsilon => capped / snr,
                PredictionType::Sample => capped,
                PredictionType::VPrediction => capped / (snr + 1.0),
            }
        };
        timesteps.iter().map(weight).collect()
    }

    /// `(a, s)` as `[batch, 1, 1]`.
    fn signal_and_noise(&self, timesteps: &[usize], like: &Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let signal = at(&self.schedule.sqrt_alphas_cumprod, timesteps);
        let noise = at(&self.schedule.sqrt_one_minus_alphas_cumprod, timesteps);
        (per_sample(&signal, like), per_sample(&noise, like))
    }
}

fn at(table: &[f64], timesteps: &[usize]) -> Vec<f64> {
    timesteps.iter().map(|&t| table[t]).collect()
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};
    use proptest::prelude::*;

    use super::*;
    use crate::BetaSchedule;

    const TYPES: [PredictionType; 3] = [
        PredictionType::Epsilon,
        PredictionType::Sample,
        PredictionType::VPrediction,
    ];

    fn normal(seed: u64, shape: [usize; 3]) -> Tensor<3> {
        let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    fn largest(x: Tensor<3>) -> f32 {
        x.abs().max().into_scalar()
    }

    fn process(prediction_type: PredictionType, snr_gamma: Option<f64>) -> GaussianDiffusion {
        let config = DiffusionConfig {
            beta_schedule: BetaSchedule::Linear,
            prediction_type,
            snr_gamma,
            ..Default::default()
        };
        GaussianDiffusion::new(&config).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn the_exact_target_gives_back_motion_and_noise(
            seed: u64,
            timesteps in prop::collection::vec(0usize..1000, 1..4),
        ) {
            let shape = [timesteps.len(), 3, 5];
            let (x_start, noise) = (normal(seed, shape), normal(seed ^ 1, shape));
            for prediction_type in TYPES {
                let process = process(prediction_type, None);
                let x_t = process.add_noise(x_start.clone(), noise.clone(), &timesteps);
                let target = process.target(x_start.clone(), noise.clone(), &timesteps);
                let x = process.pred_original_sample(target.clone(), x_t.clone(), &timesteps);
                let (from, to) = (prediction_type, PredictionType::Epsilon);
                let epsilon = process.convert(target, x_t, &timesteps, from, to);
                // Rounding errors grow by 1/a (at most 157) or by 1/s (at most 100).
                let (x, epsilon) =
                    (largest(x - x_start.clone()), largest(epsilon - noise.clone()));
                prop_assert!(x < 2e-4, "{prediction_type:?}: {x}");
                prop_assert!(epsilon < 2e-4, "{prediction_type:?}: {epsilon}");
            }
        }

        #[test]
        fn conversions_round_trip(seed: u64, timestep in 0usize..1000) {
            let process = process(PredictionType::Epsilon, None);
            let (prediction, x_t) = (normal(seed, [2, 3, 5]), normal(seed ^ 1, [2, 3, 5]));
            let timesteps = [timestep, 999 - timestep];
            for from in TYPES {
                for to in TYPES {
                    let there =
                        process.convert(prediction.clone(), x_t.clone(), &timesteps, from, to);
                    if from != to {
                        prop_assert!(largest(there.clone() - prediction.clone()) > 1e-3);
                    }
                    let back = process.convert(there, x_t.clone(), &timesteps, to, from);
                    let error = largest(back - prediction.clone());
                    prop_assert!(error < 2e-4, "{from:?} {to:?}: {error}");
                }
            }
        }
    }

    #[test]
    fn coefficients_belong_to_their_sample() {
        let process = process(PredictionType::Epsilon, None);
        let (x_start, noise) = (normal(1, [2, 3, 4]), normal(2, [2, 3, 4]));
        let both = process.add_noise(x_start.clone(), noise.clone(), &[5, 900]);
        for (index, timestep) in [5, 900].into_iter().enumerate() {
            let one = |x: &Tensor<3>| x.clone().narrow(0, index, 1);
            let alone = process.add_noise(one(&x_start), one(&noise), &[timestep]);
            assert_eq!(one(&both).into_data(), alone.into_data());
        }
    }

    #[test]
    fn loss_weights_weigh_the_clean_motion_alike() {
        let timesteps = [0, 10, 300, 999];
        let [epsilon, sample, v] =
            TYPES.map(|kind| process(kind, Some(5.0)).loss_weights(&timesteps));
        let schedule = process(PredictionType::Sample, None).schedule;
        assert_eq!(sample[0], 5.0);
        assert_eq!(epsilon[3], 1.0);
        for (i, &t) in timesteps.iter().enumerate() {
            // The squared error of the noise is snr times the motion's; that of v is snr + 1 times
            // the motion's.
            let snr = schedule.snr(t);
            assert!((epsilon[i] * snr - sample[i]).abs() < 1e-12);
            assert!((v[i] * (snr + 1.0) - sample[i]).abs() < 1e-12);
        }
        assert_eq!(
            process(PredictionType::Sample, None).loss_weights(&timesteps),
            [1.0; 4]
        );
    }

    #[test]
    fn zero_terminal_snr_stays_finite() {
        for prediction_type in [PredictionType::Sample, PredictionType::VPrediction] {
            let config = DiffusionConfig {
                prediction_type,
                rescale_betas_zero_snr: true,
                snr_gamma: Some(5.0),
                ..Default::default()
            };
            let process = GaussianDiffusion::new(&config).unwrap();
            let (x_start, noise) = (normal(1, [1, 3, 4]), normal(2, [1, 3, 4]));
            let x_t = process.add_noise(x_start.clone(), noise.clone(), &[999]);
            assert_eq!(x_t.to_data(), noise.to_data());
            let target = process.target(x_start.clone(), noise, &[999]);
            let x = process.pred_original_sample(target, x_t.clone(), &[999]);
            assert!(largest(x.clone() - x_start) < 1e-6);
            let (mean, variance) = process.posterior(x, x_t, &[999]);
            assert!(largest(mean) < 10.0 && variance[0].is_finite());
            assert_eq!(process.loss_weights(&[999]), [0.0]);
        }
    }
}
