//! The settings of a diffusion process.

use std::f64::consts::FRAC_PI_2;
use std::ops::Bound;

use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The shape of the betas over the timesteps; tables in [`crate::NoiseSchedule`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BetaSchedule {
    /// Equidistant betas from `beta_start` to `beta_end`.
    Linear,
    /// The squared cosine (Nichol and Dhariwal 2021, <https://arxiv.org/abs/2102.09672>,
    /// equation 17), each beta clipped to `[beta_min, beta_max]`.
    #[default]
    #[serde(alias = "squaredcos_cap_v2")]
    Cosine,
    /// Squares of equidistant values from `sqrt(beta_start)` to `sqrt(beta_end)`.
    #[serde(alias = "scaled_linear")]
    Sqrt,
}

/// The quantity that the network predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PredictionType {
    /// The noise that was added.
    #[default]
    Epsilon,
    /// The clean motion.
    #[serde(alias = "x0")]
    Sample,
    /// The velocity `sqrt(abar) noise - sqrt(1 - abar) x_start` (Salimans and Ho 2022,
    /// <https://arxiv.org/abs/2202.00512>, section 4).
    VPrediction,
}

/// The distance between the network's output and its target; formulas in [`crate::loss`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LossType {
    /// Squared difference.
    #[default]
    Mse,
    /// Absolute difference.
    L1,
    /// Squared near zero, absolute beyond a difference of 1.
    Huber,
}

/// The table `diffusion` of a config (CC-MotionGen, section 3.2.1; docs/sources.md, sections 1.2 to
/// 1.4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DiffusionConfig {
    /// Number of noise levels T; timesteps run from 0 to T-1. At least 2.
    pub num_train_timesteps: usize,
    /// The shape of the betas over the timesteps.
    pub beta_schedule: BetaSchedule,
    /// First beta of `linear` and `sqrt`; `cosine` does not use it.
    pub beta_start: f64,
    /// Last beta of `linear` and `sqrt`; `cosine` does not use it.
    pub beta_end: f64,
    /// Smallest beta of `cosine`. The source uses 1e-4, other programs use 0.
    pub beta_min: f64,
    /// Largest beta of `cosine`. The source uses 0.9999, other programs use 0.999.
    pub beta_max: f64,
    /// The quantity that the network predicts.
    pub prediction_type: PredictionType,
    /// The distance between the prediction and its target.
    pub loss_type: LossType,
    /// Largest signal-to-noise ratio in the min-SNR loss weights (Hang et al. 2023,
    /// <https://arxiv.org/abs/2303.09556>, use 5). If not set, all timesteps have the same weight.
    pub snr_gamma: Option<f64>,
    /// Rescales the schedule so that the last timestep is pure noise (Lin et al. 2023,
    /// <https://arxiv.org/abs/2305.08891>, algorithm 1). `epsilon` prediction does not support
    /// this. Sampling needs `trailing` or `linspace` spacing, because `leading` never visits the
    /// last timestep.
    pub rescale_betas_zero_snr: bool,
    /// Give the network the timesteps as `1000 t / num_train_timesteps`, so that their range does
    /// not depend on `num_train_timesteps`. With 1000 timesteps, this changes nothing. For networks
    /// of phrases.
    pub rescale_timesteps: bool,
    /// Probability of replacing the condition by the null condition in training, for
    /// classifier-free guidance (Ho and Salimans 2022, <https://arxiv.org/abs/2207.12598>).
    pub cond_drop_prob: f64,
    /// Probability of replacing only the style by the null style in training, for networks with a
    /// style (`model.style`). If a style has numbers and a label, the numbers alone and the label
    /// alone are each replaced with this probability too. If not set, the same as `cond_drop_prob`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style_drop_prob: Option<f64>,
}

impl Default for DiffusionConfig {
    fn default() -> Self {
        Self {
            num_train_timesteps: 1000,
            beta_schedule: BetaSchedule::default(),
            beta_start: 1e-4,
            beta_end: 0.02,
            beta_min: 1e-4,
            beta_max: 0.9999,
            prediction_type: PredictionType::default(),
            loss_type: LossType::default(),
            snr_gamma: None,
            rescale_betas_zero_snr: false,
            rescale_timesteps: false,
            cond_drop_prob: 0.1,
            style_drop_prob: None,
        }
    }
}

/// Number of timesteps to which `rescale_timesteps` rescales.
const RESCALED_TIMESTEPS: f64 = 1000.0;

/// Largest number of timesteps.
const MAX_TRAIN_TIMESTEPS: usize = 1_000_000;

/// Largest probability of dropping the style. The numbers, the label, and both together are each
/// dropped with this probability, so some samples keep both.
const MAX_STYLE_DROP: f64 = 0.3;

/// Smallest share of the motion's variance at the last timestep. With a smaller share, the factors
/// of denoising exceed the range of single precision. The share of the source's cosine schedule is
/// 2.4e-10.
const MIN_SIGNAL: f64 = 1e-30;

impl DiffusionConfig {
    /// Checks all values.
    ///
    /// # Errors
    /// Returns the first invalid key, with its value and the allowed values.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        self.check().within("diffusion")
    }

    fn check(&self) -> Result<(), InvalidSetting> {
        let timesteps = self.num_train_timesteps;
        in_range("num_train_timesteps", timesteps, 2..=MAX_TRAIN_TIMESTEPS)
            .hint("the source uses 1000")?;
        in_range("beta_start", self.beta_start, 1e-9..1.0).hint("the source uses 1e-4")?;
        in_range("beta_end", self.beta_end, self.beta_start..1.0)
            .hint("not below `beta_start`; the source uses 0.02")?;
        in_range("beta_min", self.beta_min, 0.0..1.0)
            .hint("the source uses 1e-4; 0 means no floor")?;
        let above_floor = (Bound::Excluded(self.beta_min), Bound::Excluded(1.0));
        in_range("beta_max", self.beta_max, above_floor)
            .hint("above `beta_min`; the source uses 0.9999, others 0.999")?;
        if let Some(snr_gamma) = self.snr_gamma {
            in_range("snr_gamma", snr_gamma, ABOVE_ZERO)
                .hint("the paper uses 5; leave the key out for equal weights")?;
        }
        require(
            !(self.rescale_betas_zero_snr && self.prediction_type == PredictionType::Epsilon),
            "rescale_betas_zero_snr",
            self.rescale_betas_zero_snr,
            "false when diffusion.prediction_type is \"epsilon\"",
        )
        .hint(
            "at the last timestep the input would be the noise itself, so that predicting it does \
             not determine the motion: use prediction_type \"v_prediction\" or \"sample\"",
        )?;
        in_range("cond_drop_prob", self.cond_drop_prob, 0.0..1.0).hint(
            "0.1 is usual; 0 trains without a null condition, and then only guidance_scale 1 works",
        )?;
        let style = self.style_drop_prob.unwrap_or(0.0);
        in_range("style_drop_prob", style, 0.0..=MAX_STYLE_DROP).hint(
            "0.1 is usual; it falls on the style as a whole, on its numbers and on its label",
        )?;
        let left: f64 = self.betas().iter().map(|beta| 1.0 - beta).product();
        let allowed = format!(
            "as many as leave {MIN_SIGNAL:e} of the motion's variance at the last timestep; these \
             betas leave {left:e}"
        );
        require(
            left >= MIN_SIGNAL,
            "num_train_timesteps",
            timesteps,
            allowed,
        )
        .hint(
            "use fewer timesteps, or smaller betas: they do not shrink by themselves as the \
             timesteps grow",
        )
    }

    /// The probability that the style of a sample is dropped in training.
    pub fn style_drop_prob(&self) -> f64 {
        let same = self.cond_drop_prob.min(MAX_STYLE_DROP);
        self.style_drop_prob.unwrap_or(same)
    }

    /// The factor of the timesteps that the network gets.
    pub fn timestep_scale(&self) -> f64 {
        match self.rescale_timesteps {
            true => RESCALED_TIMESTEPS / self.num_train_timesteps as f64,
            false => 1.0,
        }
    }

    /// Rejects `rescale_timesteps`, for systems whose networks get timesteps as they are.
    ///
    /// # Errors
    /// If it is set.
    pub fn must_not_rescale_timesteps(&self) -> Result<(), InvalidSetting> {
        let key = "diffusion.rescale_timesteps";
        require(!self.rescale_timesteps, key, true, "false for this recipe")
            .hint("only networks of phrases take rescaled timesteps: leave the key out")
    }

    /// The betas, one per timestep, before any rescaling.
    pub(crate) fn betas(&self) -> Vec<f64> {
        let steps = self.num_train_timesteps;
        match self.beta_schedule {
            BetaSchedule::Linear => linspace(self.beta_start, self.beta_end, steps),
            BetaSchedule::Sqrt => linspace(self.beta_start.sqrt(), self.beta_end.sqrt(), steps)
                .into_iter()
                .map(|root| root * root)
                .collect(),
            BetaSchedule::Cosine => (0..steps)
                .map(|t| cosine_beta(t, steps).clamp(self.beta_min, self.beta_max))
                .collect(),
        }
    }
}

/// `n` (at least 2) equidistant values, both ends exact.
fn linspace(start: f64, end: f64, n: usize) -> Vec<f64> {
    let step = (end - start) / (n - 1) as f64;
    let mut values: Vec<f64> = (0..n).map(|i| start + i as f64 * step).collect();
    values[n - 1] = end;
    values
}

/// Offset of the cosine schedule that keeps the first betas above 0.
const COSINE_OFFSET: f64 = 0.008;

/// `1 - cos^2(b) / cos^2(a)` with `a`, `b` the angles of t and t+1, as in the sources. The smallest
/// beta loses 5 of its 16 digits; a more precise formula would not match the published betas.
fn cosine_beta(t: usize, steps: usize) -> f64 {
    let cumulative = |t: usize| {
        let angle = (t as f64 / steps as f64 + COSINE_OFFSET) / (1.0 + COSINE_OFFSET) * FRAC_PI_2;
        angle.cos().powi(2)
    };
    1.0 - cumulative(t + 1) / cumulative(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(json: &str) -> Result<DiffusionConfig, serde_json::Error> {
        serde_json::from_str(json)
    }

    #[test]
    fn an_empty_table_is_the_default_and_valid() {
        let config = parse("{}").unwrap();
        assert_eq!(config, DiffusionConfig::default());
        config.validate().unwrap();
    }

    #[test]
    fn aliases_are_the_names_of_other_projects() {
        let config = parse(
            r#"{"beta_schedule": "scaled_linear", "prediction_type": "x0", "loss_type": "l1"}"#,
        )
        .unwrap();
        assert_eq!(config.beta_schedule, BetaSchedule::Sqrt);
        assert_eq!(config.prediction_type, PredictionType::Sample);
        assert_eq!(config.loss_type, LossType::L1);
        let config = parse(r#"{"beta_schedule": "squaredcos_cap_v2"}"#).unwrap();
        assert_eq!(config.beta_schedule, BetaSchedule::Cosine);
        let config = parse(r#"{"prediction_type": "v_prediction"}"#).unwrap();
        assert_eq!(config.prediction_type, PredictionType::VPrediction);
    }

    #[test]
    fn saving_and_reading_gives_the_same_config() {
        let config = DiffusionConfig {
            beta_schedule: BetaSchedule::Sqrt,
            prediction_type: PredictionType::VPrediction,
            loss_type: LossType::Huber,
            snr_gamma: Some(5.0),
            rescale_betas_zero_snr: true,
            beta_min: 0.1 + 0.2,
            ..Default::default()
        };
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(parse(&text).unwrap(), config);
    }

    #[test]
    fn rescaled_timesteps_have_the_range_of_1000_timesteps() {
        let scale = |json: &str| parse(json).unwrap().timestep_scale();
        assert_eq!(scale("{}"), 1.0);
        assert_eq!(scale(r#"{"num_train_timesteps": 250}"#), 1.0);
        assert_eq!(
            scale(r#"{"num_train_timesteps": 250, "rescale_timesteps": true}"#),
            4.0
        );
        assert_eq!(scale(r#"{"rescale_timesteps": true}"#), 1.0);
    }

    #[test]
    fn unknown_keys_and_names_are_refused() {
        assert!(parse(r#"{"timesteps": 1000}"#).is_err());
        assert!(parse(r#"{"beta_schedule": "cosin"}"#).is_err());
        assert!(parse(r#"{"num_train_timesteps": -1}"#).is_err());
    }

    #[test]
    fn every_bad_value_is_refused_by_name() {
        let cases = [
            (r#"{"num_train_timesteps": 1}"#, "num_train_timesteps", "1"),
            (
                r#"{"num_train_timesteps": 1000001}"#,
                "num_train_timesteps",
                "1000001",
            ),
            (r#"{"beta_start": 0.0}"#, "beta_start", "0"),
            (r#"{"beta_start": 1.0, "beta_end": 1.0}"#, "beta_start", "1"),
            (
                r#"{"beta_schedule": "linear", "num_train_timesteps": 9000}"#,
                "num_train_timesteps",
                "9000",
            ),
            (r#"{"beta_min": 0.5}"#, "num_train_timesteps", "1000"),
            (r#"{"beta_end": 0.00001}"#, "beta_end", "0.00001"),
            (r#"{"beta_end": 1.0}"#, "beta_end", "1"),
            (r#"{"beta_min": -0.1}"#, "beta_min", "-0.1"),
            (r#"{"beta_max": 1.0}"#, "beta_max", "1"),
            (r#"{"beta_min": 0.5, "beta_max": 0.5}"#, "beta_max", "0.5"),
            (r#"{"snr_gamma": 0.0}"#, "snr_gamma", "0"),
            (
                r#"{"rescale_betas_zero_snr": true}"#,
                "rescale_betas_zero_snr",
                "true",
            ),
            (r#"{"cond_drop_prob": 1.0}"#, "cond_drop_prob", "1"),
            (r#"{"cond_drop_prob": -0.5}"#, "cond_drop_prob", "-0.5"),
            (r#"{"style_drop_prob": 0.5}"#, "style_drop_prob", "0.5"),
        ];
        for (json, key, found) in cases {
            let error = parse(json).unwrap().validate().unwrap_err();
            let text = error.to_string();
            assert!(
                text.starts_with(&format!("`diffusion.{key}` is {found}, allowed: ")),
                "{text}"
            );
        }
        for set in [
            |c: &mut DiffusionConfig| c.beta_end = f64::NAN,
            |c: &mut DiffusionConfig| c.beta_min = f64::NAN,
            |c: &mut DiffusionConfig| c.snr_gamma = Some(f64::NAN),
            |c: &mut DiffusionConfig| c.cond_drop_prob = f64::NAN,
        ] {
            let mut config = DiffusionConfig::default();
            set(&mut config);
            config.validate().unwrap_err();
        }
    }
}
