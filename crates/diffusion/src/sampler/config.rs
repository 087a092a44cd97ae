//! The settings of a sampler.

use std::fmt;

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::spacing::timesteps;
use crate::{DiffusionConfig, GuidanceScales};

/// A sampler of a diffusion process or of a flow (CC-MotionGen, sections 3.2.1 and 8.1;
/// docs/sources.md, section 1.9).
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(default)]
pub struct SamplerConfig {
    /// The sampling algorithm.
    #[serde(flatten)]
    pub kind: SamplerKind,
    /// Number of steps, at most the process's number of timesteps.
    pub num_inference_steps: usize,
    /// Classifier-free guidance scale; 1 disables guidance.
    pub guidance_scale: f64,
    /// Guidance scale of the style, for models with a style (`model.style`); if not set, the same
    /// as `guidance_scale`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style_guidance_scale: Option<f64>,
}

/// The sampling algorithm, with its own settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SamplerKind {
    /// DDIM: deterministic at `eta` 0, suitable for few steps.
    Ddim(Ddim),
    /// DDPM (ancestral sampling): samples from the posterior in every step.
    Ddpm(Ddpm),
    /// DPM-Solver++ (2M): deterministic, second order.
    #[serde(rename = "dpmpp_2m")]
    Dpmpp2m(Timesteps),
    /// Heun's method: deterministic, second order, two network calls per step. Also for flows.
    Heun(Timesteps),
    /// Euler's method, for flows: first order, one network call per step.
    Euler,
    /// The midpoint method, for flows: second order, two network calls per step.
    Midpoint,
    /// Dormand and Prince's method, for flows: order 5, six network calls per step. A `tolerance`
    /// makes the step size adaptive.
    Dopri5(Dopri5),
}

/// The settings of DDIM.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(default)]
pub struct Ddim {
    /// The visited and the guided timesteps.
    #[serde(flatten)]
    pub timesteps: Timesteps,
    /// Scale of the added noise, from 0 (deterministic) to 1 (DDPM).
    pub eta: f64,
    /// The end of the last step. Other samplers end at the clean motion.
    pub final_alpha: FinalAlpha,
    /// Recompute the noise from the clipped motion after clipping. The source keeps the network's
    /// noise, which is inconsistent with the clipped motion.
    pub recompute_epsilon: bool,
}

/// The settings of DDPM.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[schemars(default)]
pub struct Ddpm {
    /// The visited and the guided timesteps.
    #[serde(flatten)]
    pub timesteps: Timesteps,
    /// The variance of a step.
    pub variance_type: VarianceType,
}

/// The visited and the guided timesteps of a sampler of a diffusion process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[schemars(default)]
pub struct Timesteps {
    /// Spacing of the timesteps.
    pub timestep_spacing: TimestepSpacing,
    /// Timestep below which guidance scales are limited to 1; with 0, guidance acts at all
    /// timesteps. Guidance amplifies the network's errors, which make a motion shake at low noise.
    /// There the motion's content is already determined (Kynkäänniemi et al. 2024,
    /// <https://arxiv.org/abs/2404.07724>).
    pub guidance_until: usize,
}

/// The settings of the method of Dormand and Prince.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[schemars(default)]
pub struct Dopri5 {
    /// Largest error of a step, for values of size 1. With a tolerance, `num_inference_steps` is
    /// not used. If not set, all steps have the same size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
}

/// The rule for the N timesteps of a sampler out of T: entry i of 0..N, noisiest first.
///
/// `leading`, `linspace` and `trailing` are the names of table 2 of Lin et al. 2023,
/// <https://arxiv.org/abs/2305.08891>. With N = T all four are T-1, T-2, ..., 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimestepSpacing {
    /// `T-1 - i floor(T/N)`, the source's rule (CC-MotionGen, section 8.1; docs/sources.md, section
    /// 1.9). The timesteps begin at T-1 and end above 0. If N does not divide T, they omit the low
    /// end.
    #[serde(rename = "ccmotion")]
    CcMotion,
    /// `(N-1-i) floor(T/N)`: from below T-1 to 0.
    Leading,
    /// `floor((T-1) (N-1-i) / (N-1))`, in integers; T-1 for N = 1. T-1 and 0 are included (section
    /// 7.3).
    #[default]
    Linspace,
    /// `round(T (N-i) / N) - 1`, ties to even: from T-1 to near T/N.
    Trailing,
}

/// The fixed variance of a step of DDPM (CC-MotionGen, section 5.2; Ho et al. 2020,
/// <https://arxiv.org/abs/2006.11239>, section 3.2). In both, a step to the clean motion has
/// variance 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum VarianceType {
    /// The posterior variance, `beta (1 - abar') / (1 - abar)`: the smallest choice, right for data
    /// of one point.
    #[default]
    FixedSmall,
    /// `beta`: the largest choice, right for normally distributed data.
    FixedLarge,
}

/// The end of the last step of DDIM.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinalAlpha {
    /// Timestep 0, `abar[0]` (section 8.1): its noise remains in the sample.
    First,
    /// The clean motion, `abar = 1` (section 7.3).
    #[default]
    One,
}

impl Default for SamplerConfig {
    fn default() -> Self {
        Self::new(SamplerKind::default(), 20)
    }
}

impl Default for SamplerKind {
    fn default() -> Self {
        Self::Ddim(Ddim::default())
    }
}

impl Default for Ddim {
    fn default() -> Self {
        Self {
            timesteps: Timesteps::default(),
            eta: 0.0,
            final_alpha: FinalAlpha::default(),
            recompute_epsilon: true,
        }
    }
}

impl From<Timesteps> for Ddpm {
    /// DDPM of these timesteps with the default variance.
    fn from(timesteps: Timesteps) -> Self {
        Self {
            timesteps,
            ..Self::default()
        }
    }
}

impl SamplerKind {
    /// The settings of the timesteps; `None` for samplers of flows only.
    pub fn timesteps(&self) -> Option<&Timesteps> {
        match self {
            Self::Ddim(Ddim { timesteps, .. })
            | Self::Ddpm(Ddpm { timesteps, .. })
            | Self::Dpmpp2m(timesteps)
            | Self::Heun(timesteps) => Some(timesteps),
            Self::Euler | Self::Midpoint | Self::Dopri5(_) => None,
        }
    }
}

impl fmt::Display for SamplerKind {
    /// The name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ddim(_) => "ddim",
            Self::Ddpm(_) => "ddpm",
            Self::Dpmpp2m(_) => "dpmpp_2m",
            Self::Heun(_) => "heun",
            Self::Euler => "euler",
            Self::Midpoint => "midpoint",
            Self::Dopri5(_) => "dopri5",
        })
    }
}

impl SamplerConfig {
    /// A sampler of `num_inference_steps` steps without guidance.
    pub fn new(kind: SamplerKind, num_inference_steps: usize) -> Self {
        Self {
            kind,
            num_inference_steps,
            guidance_scale: 1.0,
            style_guidance_scale: None,
        }
    }

    /// The guidance scales of the conditions at a timestep.
    pub fn guidance(&self, timestep: usize) -> GuidanceScales {
        let timesteps = self.kind.timesteps();
        // Scales up to 1 do not amplify errors; a scale of 0 remains the unconditional prediction.
        let most = match timesteps.is_some_and(|all| timestep < all.guidance_until) {
            true => 1.0,
            false => f64::INFINITY,
        };
        let style = self.style_guidance_scale.map(|scale| scale.min(most));
        GuidanceScales::new(self.guidance_scale.min(most), style)
    }

    /// Number of predictions in a diffusion process. For a flow, see
    /// [`Flowed::evaluations`](crate::Flowed::evaluations).
    pub fn network_evaluations(&self) -> usize {
        match self.kind {
            // The last step ends at the clean motion, where the slope is undefined.
            SamplerKind::Heun(_) => (2 * self.num_inference_steps).saturating_sub(1),
            _ => self.num_inference_steps,
        }
    }

    /// The timestep at the end of the last step; `None` is the clean motion.
    pub(super) fn last_prev_timestep(&self) -> Option<usize> {
        match &self.kind {
            SamplerKind::Ddim(ddim) if ddim.final_alpha == FinalAlpha::First => Some(0),
            _ => None,
        }
    }
}

/// The table of a sampler's settings in a config.
const TABLE: &str = "sampling.sampler";

/// Largest number of steps of a flow.
const MAX_FLOW_STEPS: usize = 10_000;

/// Checks a sampler's settings for a diffusion process.
///
/// # Errors
/// Returns the first invalid key, with its value and the allowed values.
pub fn must_suit(config: &SamplerConfig, process: &DiffusionConfig) -> Result<(), InvalidSetting> {
    suits(config, process).within(TABLE)
}

/// Checks a sampler's settings for a flow.
///
/// # Errors
/// Returns the first invalid key, with its value and the allowed values.
pub fn must_suit_flow(config: &SamplerConfig) -> Result<(), InvalidSetting> {
    suits_flow(config).within(TABLE)
}

fn suits(config: &SamplerConfig, process: &DiffusionConfig) -> Result<(), InvalidSetting> {
    let (all, steps) = (process.num_train_timesteps, config.num_inference_steps);
    let most = format!("diffusion.num_train_timesteps ({all})");
    let fits = (1..=all).contains(&steps);
    require(fits, "num_inference_steps", steps, format!("1 to {most}"))
        .hint("20 to 50 are usual for ddim")?;
    if let SamplerKind::Ddim(Ddim { eta, .. }) = config.kind {
        in_range("eta", eta, 0.0..=1.0).hint("0 adds no noise, 1 as much as ddpm")?;
    }
    guides(config)?;
    let kind = format!("\"{}\"", config.kind);
    let Some(visited) = config.kind.timesteps() else {
        let allowed = "\"ddim\", \"ddpm\", \"dpmpp_2m\" or \"heun\" for a diffusion process";
        let refused = InvalidSetting::new("kind", kind, allowed);
        return Err(refused.hint("the others are of flows: recipe `flow`"));
    };
    let until = visited.guidance_until;
    require(
        until <= all,
        "guidance_until",
        until,
        format!("0 to {most}"),
    )
    .hint("0 guides at all timesteps")?;
    let heun = matches!(config.kind, SamplerKind::Heun(_));
    let from_noise = || timesteps(config, all).contains(&(all - 1));
    require(
        !(heun && process.rescale_betas_zero_snr && from_noise()),
        "kind",
        kind,
        "another sampler where `diffusion.rescale_betas_zero_snr` is set",
    )
    .hint("Heun's method needs some motion in x_t, and the last timestep is pure noise")
}

fn suits_flow(config: &SamplerConfig) -> Result<(), InvalidSetting> {
    let usual = Timesteps::default();
    let visited = match &config.kind {
        SamplerKind::Euler | SamplerKind::Midpoint | SamplerKind::Dopri5(_) => &usual,
        SamplerKind::Heun(visited) => visited,
        kind => {
            let allowed = "\"euler\", \"midpoint\", \"heun\" or \"dopri5\" for recipe `flow`";
            let refused = InvalidSetting::new("kind", format!("\"{kind}\""), allowed);
            return Err(refused.hint("the others are of diffusion processes"));
        }
    };
    let style = config.style_guidance_scale;
    for (key, is_usual) in [
        (
            "timestep_spacing",
            visited.timestep_spacing == usual.timestep_spacing,
        ),
        (
            "guidance_until",
            visited.guidance_until == usual.guidance_until,
        ),
        ("style_guidance_scale", style.is_none()),
    ] {
        let nothing = "left out for recipe `flow`: it is of diffusion processes";
        require(is_usual, key, "set", nothing)?;
    }
    let steps = config.num_inference_steps;
    in_range("num_inference_steps", steps, 1..=MAX_FLOW_STEPS)
        .hint("5 to 10 are usual for euler")?;
    if let SamplerKind::Dopri5(Dopri5 {
        tolerance: Some(tolerance),
    }) = config.kind
    {
        in_range("tolerance", tolerance, 1e-6..=1.0)
            .hint("1e-3 to 1e-5 are usual in single precision")?;
    }
    guides(config)
}

fn guides(config: &SamplerConfig) -> Result<(), InvalidSetting> {
    in_range("guidance_scale", config.guidance_scale, 0.0..)
        .hint("1 is the condition as trained; 2 to 3 exaggerate it")?;
    let style = config.style_guidance_scale.unwrap_or(1.0);
    in_range("style_guidance_scale", style, 0.0..)
        .hint("leave it out for the same as `guidance_scale`")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(config: &SamplerConfig, flow: bool) -> Option<String> {
        let process = DiffusionConfig {
            num_train_timesteps: 50,
            ..DiffusionConfig::default()
        };
        let suits = match flow {
            true => must_suit_flow(config),
            false => must_suit(config, &process),
        };
        suits.err().map(|refused| refused.to_string())
    }

    fn ddim(eta: f64) -> SamplerConfig {
        let ddim = Ddim {
            eta,
            ..Ddim::default()
        };
        SamplerConfig::new(SamplerKind::Ddim(ddim), 20)
    }

    fn heun(timestep_spacing: TimestepSpacing, guidance_until: usize) -> SamplerConfig {
        let timesteps = Timesteps {
            timestep_spacing,
            guidance_until,
        };
        SamplerConfig::new(SamplerKind::Heun(timesteps), 50)
    }

    fn dopri5(tolerance: f64) -> SamplerConfig {
        let tolerance = Some(tolerance);
        SamplerConfig::new(SamplerKind::Dopri5(Dopri5 { tolerance }), 5)
    }

    #[test]
    fn guidance_ends_below_its_timestep() {
        let config = SamplerConfig {
            guidance_scale: 2.5,
            style_guidance_scale: Some(0.5),
            ..heun(TimestepSpacing::Linspace, 30)
        };
        assert_eq!(config.guidance(30), GuidanceScales::new(2.5, Some(0.5)));
        assert_eq!(config.guidance(29), GuidanceScales::new(1.0, Some(0.5)));
        let unconditional = SamplerConfig {
            guidance_scale: 0.0,
            ..config
        };
        assert_eq!(unconditional.guidance(29).cond, 0.0);
        assert_eq!(SamplerConfig::default().guidance(0).calls(), 1);
    }

    #[test]
    fn every_bad_value_is_refused_by_name() {
        let steps = |kind: SamplerKind, steps: usize| SamplerConfig::new(kind, steps);
        let guided = |guidance_scale, style_guidance_scale| SamplerConfig {
            guidance_scale,
            style_guidance_scale,
            ..SamplerConfig::default()
        };
        let euler = |guidance_scale, style_guidance_scale| SamplerConfig {
            kind: SamplerKind::Euler,
            ..guided(guidance_scale, style_guidance_scale)
        };
        for (config, flow, start) in [
            (
                steps(SamplerKind::default(), 0),
                false,
                "num_inference_steps` is 0",
            ),
            (
                steps(SamplerKind::default(), 51),
                false,
                "num_inference_steps` is 51",
            ),
            (ddim(-0.1), false, "eta` is -0.1"),
            (ddim(1.5), false, "eta` is 1.5"),
            (ddim(f64::NAN), false, "eta` is NaN"),
            (guided(-1.0, None), false, "guidance_scale` is -1"),
            (guided(f64::INFINITY, None), false, "guidance_scale` is inf"),
            (
                guided(1.0, Some(-0.5)),
                false,
                "style_guidance_scale` is -0.5",
            ),
            (
                heun(TimestepSpacing::Linspace, 51),
                false,
                "guidance_until` is 51",
            ),
            (steps(SamplerKind::Euler, 5), false, "kind` is \"euler\""),
            (dopri5(1e-3), false, "kind` is \"dopri5\""),
            (
                steps(SamplerKind::Euler, 0),
                true,
                "num_inference_steps` is 0",
            ),
            (
                steps(SamplerKind::Euler, 10_001),
                true,
                "num_inference_steps` is 10001",
            ),
            (dopri5(0.0), true, "tolerance` is 0"),
            (dopri5(f64::NAN), true, "tolerance` is NaN"),
            (euler(-1.0, None), true, "guidance_scale` is -1"),
            (euler(f64::INFINITY, None), true, "guidance_scale` is inf"),
            (euler(1.0, Some(2.0)), true, "style_guidance_scale` is set"),
            (
                heun(TimestepSpacing::Leading, 0),
                true,
                "timestep_spacing` is set",
            ),
            (
                heun(TimestepSpacing::Linspace, 3),
                true,
                "guidance_until` is set",
            ),
            (ddim(0.0), true, "kind` is \"ddim\""),
        ] {
            let text = refused(&config, flow).expect(start);
            let start = format!("`sampling.sampler.{start}, allowed: ");
            assert!(text.starts_with(&start), "{text}");
        }
        for (config, flow) in [
            (ddim(1.0), false),
            (heun(TimestepSpacing::Trailing, 50), false),
            (heun(TimestepSpacing::Linspace, 0), true),
            (steps(SamplerKind::Midpoint, 10_000), true),
            (dopri5(1e-4), true),
        ] {
            assert_eq!(refused(&config, flow), None, "{config:?}");
        }
    }
}
