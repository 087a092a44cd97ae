//! Noise schedules.

use kinegrad_settings::InvalidSetting;

use crate::DiffusionConfig;

/// Tables over the timesteps 0..T, in f64 on the host; built by [`NoiseSchedule::new`].
///
/// With `abar` for `alphas_cumprod` (CC-MotionGen, sections 3.2.2, 5.1 and 5.2; docs/sources.md,
/// section 1.2):
///
/// ```text
/// linear   beta_t = T equidistant values from beta_start to beta_end
/// sqrt     beta_t = squares of T equidistant values from sqrt(beta_start) to sqrt(beta_end)
/// cosine   beta_t = clip(1 - f((t+1)/T) / f(t/T), beta_min, beta_max),
///          f(u) = cos^2(pi/2 (u + 0.008) / 1.008)
/// ```
///
/// Values are rounded to single precision only when used. If computed from a rounded `abar`,
/// `sqrt(1 - abar)` would be wrong by up to 1.5e-4 at t = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseSchedule {
    /// Variance of the noise that step t adds.
    pub betas: Vec<f64>,
    /// `1 - beta_t`.
    pub alphas: Vec<f64>,
    /// Cumulative product of `alphas`, the share of the motion's variance at t.
    pub alphas_cumprod: Vec<f64>,
    /// `abar` one timestep earlier; 1 at t = 0.
    pub alphas_cumprod_prev: Vec<f64>,
    /// `1 - abar`, computed without cancellation near t = 0.
    pub one_minus_alphas_cumprod: Vec<f64>,
    /// `sqrt(abar)`, the factor of the motion in x_t.
    pub sqrt_alphas_cumprod: Vec<f64>,
    /// `sqrt(1 - abar)`, the factor of the noise in x_t.
    pub sqrt_one_minus_alphas_cumprod: Vec<f64>,
    /// `sqrt(1 / abar)`; infinite where `abar` is 0.
    pub sqrt_recip_alphas_cumprod: Vec<f64>,
    /// `sqrt(1 / abar - 1)`; infinite where `abar` is 0.
    pub sqrt_recipm1_alphas_cumprod: Vec<f64>,
    /// Factor of x_0 in the posterior mean: `beta sqrt(abar_prev) / (1 - abar)`.
    pub posterior_mean_coef1: Vec<f64>,
    /// Factor of x_t in the posterior mean: `(1 - abar_prev) sqrt(alpha) / (1 - abar)`.
    pub posterior_mean_coef2: Vec<f64>,
    /// Variance of the posterior: `beta (1 - abar_prev) / (1 - abar)`; 0 at t = 0.
    pub posterior_variance: Vec<f64>,
}

/// Shares of a network's output in the mean of a DDPM step, over the timesteps (Guided Motion
/// Diffusion, appendix A, figure A.1; docs/sources.md, section 4.5).
#[derive(Clone, Debug, PartialEq)]
pub struct OutputShares {
    /// Of a network that predicts the clean motion: `a / (a + b)` of the mean `a x_0 + b x_t`.
    pub sample: Vec<f64>,
    /// Of a network that predicts the noise: `d / (c + d)` of the mean `c x_t - d epsilon`.
    pub epsilon: Vec<f64>,
}

impl NoiseSchedule {
    /// The shares of a network's output in the mean of each step, with `a` and `b` the coefficients
    /// of the posterior mean, and
    ///
    /// ```text
    /// c = a / sqrt(abar) + b      d = a sqrt(1 - abar) / sqrt(abar)
    /// ```
    pub fn output_shares(&self) -> OutputShares {
        let (a, b) = (&self.posterior_mean_coef1, &self.posterior_mean_coef2);
        let timesteps = 0..self.num_train_timesteps();
        // Multiplied by sqrt(abar), which may be 0 at the last timestep.
        let epsilon = |t: usize| {
            let d = a[t] * self.sqrt_one_minus_alphas_cumprod[t];
            d / (a[t] + b[t] * self.sqrt_alphas_cumprod[t] + d)
        };
        OutputShares {
            sample: timesteps.clone().map(|t| a[t] / (a[t] + b[t])).collect(),
            epsilon: timesteps.map(epsilon).collect(),
        }
    }

    /// The tables of `config`.
    ///
    /// # Errors
    /// Fails if the config is not valid ([`DiffusionConfig::validate`]).
    pub fn new(config: &DiffusionConfig) -> Result<Self, InvalidSetting> {
        config.validate()?;
        let mut betas = config.betas();
        if config.rescale_betas_zero_snr {
            betas = rescale_zero_terminal_snr(&betas);
        }
        Ok(Self::from_betas(betas))
    }

    fn from_betas(betas: Vec<f64>) -> Self {
        let steps = betas.len();
        // Entry t + 1 belongs to timestep t.
        let (mut abar, mut rest) = (vec![1.0], vec![0.0]);
        for (t, beta) in betas.iter().enumerate() {
            // 1 - abar = (1 - abar_prev) + abar_prev beta has only positive terms, so nothing
            // cancels.
            rest.push(rest[t] + abar[t] * beta);
            abar.push(abar[t] * (1.0 - beta));
        }
        let alphas: Vec<f64> = betas.iter().map(|beta| 1.0 - beta).collect();
        let table = |entry: &dyn Fn(usize) -> f64| (0..steps).map(entry).collect();
        Self {
            sqrt_alphas_cumprod: table(&|t| abar[t + 1].sqrt()),
            sqrt_one_minus_alphas_cumprod: table(&|t| rest[t + 1].sqrt()),
            sqrt_recip_alphas_cumprod: table(&|t| (1.0 / abar[t + 1]).sqrt()),
            sqrt_recipm1_alphas_cumprod: table(&|t| (rest[t + 1] / abar[t + 1]).sqrt()),
            posterior_mean_coef1: table(&|t| betas[t] * abar[t].sqrt() / rest[t + 1]),
            posterior_mean_coef2: table(&|t| rest[t] * alphas[t].sqrt() / rest[t + 1]),
            posterior_variance: table(&|t| betas[t] * rest[t] / rest[t + 1]),
            alphas_cumprod: abar[1..].to_vec(),
            alphas_cumprod_prev: abar[..steps].to_vec(),
            one_minus_alphas_cumprod: rest[1..].to_vec(),
            alphas,
            betas,
        }
    }

    /// T, the number of timesteps.
    pub fn num_train_timesteps(&self) -> usize {
        self.betas.len()
    }

    /// Signal-to-noise ratio `abar / (1 - abar)` at `timestep`.
    ///
    /// # Panics
    /// Panics if the timestep is not below T.
    pub fn snr(&self, timestep: usize) -> f64 {
        self.alphas_cumprod[timestep] / self.one_minus_alphas_cumprod[timestep]
    }

    /// `(abar, 1 - abar)` at a timestep; `None` is the clean motion, (1, 0).
    ///
    /// # Panics
    /// Panics if the timestep is not below T.
    pub fn abar_at(&self, timestep: Option<usize>) -> (f64, f64) {
        match timestep {
            Some(t) => (self.alphas_cumprod[t], self.one_minus_alphas_cumprod[t]),
            None => (1.0, 0.0),
        }
    }
}

/// Algorithm 1 of Lin et al. 2023: shifts `sqrt(abar)` to 0 at the last timestep and rescales
/// `sqrt(abar)` to the old value at the first.
fn rescale_zero_terminal_snr(betas: &[f64]) -> Vec<f64> {
    let mut product = 1.0;
    let roots: Vec<f64> = betas
        .iter()
        .map(|beta| {
            product *= 1.0 - beta;
            f64::sqrt(product)
        })
        .collect();
    let (first, last) = (roots[0], roots[roots.len() - 1]);
    let mut abar_prev = 1.0;
    roots
        .iter()
        .map(|root| {
            let abar = ((root - last) * first / (first - last)).powi(2);
            let beta = 1.0 - abar / abar_prev;
            abar_prev = abar;
            beta
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::BetaSchedule;
    use crate::PredictionType;

    #[test]
    fn a_clean_motion_decides_the_end_of_sampling_and_noise_its_beginning() {
        let config = DiffusionConfig {
            beta_schedule: BetaSchedule::Cosine,
            beta_min: 0.0,
            beta_max: 0.999,
            ..DiffusionConfig::default()
        };
        let schedule = NoiseSchedule::new(&config).unwrap();
        let OutputShares { sample, epsilon } = schedule.output_shares();
        assert_eq!(sample[0], 1.0);
        assert!(
            sample[1..]
                .windows(2)
                .all(|pair| pair[1] < pair[0] || pair[0] < 0.05)
        );
        assert!(epsilon[0] < 0.1 && epsilon[999] > 0.45);
        // The coefficients of equation 2.
        for t in [1, 500, 998] {
            let (a, b) = (
                schedule.posterior_mean_coef1[t],
                schedule.posterior_mean_coef2[t],
            );
            let root = schedule.alphas_cumprod[t].sqrt();
            let (c, d) = (a / root + b, a * (1.0 - root * root).sqrt() / root);
            assert!((epsilon[t] / (d / (c + d)) - 1.0).abs() < 1e-6, "{t}");
        }
        let zero = DiffusionConfig {
            rescale_betas_zero_snr: true,
            prediction_type: PredictionType::Sample,
            ..config
        };
        let shares = NoiseSchedule::new(&zero).unwrap().output_shares();
        assert!(
            shares
                .epsilon
                .iter()
                .all(|share| (0.0..=1.0).contains(share))
        );
    }

    fn any_schedule() -> impl Strategy<Value = BetaSchedule> {
        prop_oneof![
            Just(BetaSchedule::Linear),
            Just(BetaSchedule::Cosine),
            Just(BetaSchedule::Sqrt)
        ]
    }

    proptest! {
        #[test]
        fn alphas_cumprod_decreases_and_the_tables_agree(
            beta_schedule in any_schedule(),
            num_train_timesteps in 2usize..1200,
            beta_min in prop_oneof![Just(0.0), 1e-6..1e-3],
            rescale in any::<bool>(),
        ) {
            let config = DiffusionConfig {
                num_train_timesteps,
                beta_schedule,
                beta_min,
                rescale_betas_zero_snr: rescale,
                prediction_type: PredictionType::Sample,
                ..Default::default()
            };
            let schedule = NoiseSchedule::new(&config).unwrap();
            prop_assert_eq!(schedule.num_train_timesteps(), num_train_timesteps);
            let abar = &schedule.alphas_cumprod;
            prop_assert!(abar[0] < 1.0);
            prop_assert!(abar.windows(2).all(|pair| pair[1] < pair[0]));
            for (t, share) in abar.iter().enumerate() {
                let sum = share + schedule.one_minus_alphas_cumprod[t];
                prop_assert!((sum - 1.0).abs() < 1e-12, "t {t}: {sum}");
                // The posterior mean of x_t = sqrt(abar) x_0 is sqrt(abar_prev) x_0.
                let mean = schedule.posterior_mean_coef1[t]
                    + schedule.posterior_mean_coef2[t] * schedule.sqrt_alphas_cumprod[t];
                let expected = schedule.alphas_cumprod_prev[t].sqrt();
                prop_assert!((mean - expected).abs() < 1e-11, "t {t}: {mean} {expected}");
            }
        }
    }

    #[test]
    fn zero_terminal_snr_ends_in_pure_noise_and_keeps_the_start() {
        let plain = DiffusionConfig {
            beta_schedule: BetaSchedule::Linear,
            prediction_type: PredictionType::VPrediction,
            ..Default::default()
        };
        let rescaled = DiffusionConfig {
            rescale_betas_zero_snr: true,
            ..plain.clone()
        };
        let (plain, rescaled) = (
            NoiseSchedule::new(&plain).unwrap(),
            NoiseSchedule::new(&rescaled).unwrap(),
        );
        let last = plain.num_train_timesteps() - 1;
        assert!(plain.snr(last) > 0.0);
        assert_eq!(rescaled.snr(last), 0.0);
        assert!((rescaled.sqrt_one_minus_alphas_cumprod[last] - 1.0).abs() < 1e-12);
        assert!((rescaled.alphas_cumprod[0] - plain.alphas_cumprod[0]).abs() < 1e-15);
        assert_eq!(rescaled.posterior_mean_coef2[last], 0.0);
    }

    #[test]
    fn cosine_without_bounds_follows_its_curve() {
        let config = DiffusionConfig {
            num_train_timesteps: 400,
            beta_min: 0.0,
            beta_max: 0.999,
            ..Default::default()
        };
        let schedule = NoiseSchedule::new(&config).unwrap();
        let f = |u: f64| (FRAC_PI_2 * (u + 0.008) / 1.008).cos().powi(2);
        // Only the beta of the last timestep is clipped.
        for t in 0..399 {
            let expected = f((t + 1) as f64 / 400.0) / f(0.0);
            assert!(
                (schedule.alphas_cumprod[t] - expected).abs() < 1e-13,
                "t {t}"
            );
        }
        assert_eq!(schedule.betas[399], 0.999);
    }

    #[test]
    fn an_invalid_config_builds_nothing() {
        let config = DiffusionConfig {
            num_train_timesteps: 1,
            ..Default::default()
        };
        NoiseSchedule::new(&config).unwrap_err();
    }
}
