//! The settings of a sampler.

use std::fmt;

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{FlowSolver, GuidanceScales};

/// The sampling algorithm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SamplerKind {
    /// DDIM: deterministic at `eta` 0, and good with few steps.
    #[default]
    Ddim,
    /// Ancestral sampling: samples from the posterior in every step.
    Ddpm,
    /// DPM-Solver++ (2M): deterministic and of second order.
    #[serde(rename = "dpmpp_2m")]
    Dpmpp2m,
    /// Deterministic and of second order, with two calls of the network a step. For flows too.
    Heun,
    /// Of a flow: of first order, one call of the network a step.
    Euler,
    /// Of a flow: of second order, two calls a step.
    Midpoint,
    /// Of a flow: Dormand and Prince's method of order 5, six calls a step; with a `tolerance` it
    /// chooses its steps itself.
    Dopri5,
}

impl SamplerKind {
    /// Those that follow the velocity of a flow; none of a diffusion process alone.
    pub fn flow(self) -> Option<FlowSolver> {
        match self {
            Self::Ddim | Self::Ddpm | Self::Dpmpp2m => None,
            Self::Heun => Some(FlowSolver::Heun),
            Self::Euler => Some(FlowSolver::Euler),
            Self::Midpoint => Some(FlowSolver::Midpoint),
            Self::Dopri5 => Some(FlowSolver::Dopri5),
        }
    }

    /// Whether it goes backward through a diffusion process.
    pub fn is_of_diffusion(self) -> bool {
        matches!(self, Self::Ddim | Self::Ddpm | Self::Dpmpp2m | Self::Heun)
    }
}

impl fmt::Display for SamplerKind {
    /// Its name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Which timesteps a sampler of N steps visits out of T; entry i of 0..N, noisiest first.
///
/// `leading`, `linspace` and `trailing` are the names of table 2 of Lin et al. 2023,
/// <https://arxiv.org/abs/2305.08891>. With N = T all four are T-1, T-2, ..., 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimestepSpacing {
    /// `T-1 - i floor(T/N)`: the source's rule (CC-MotionGen, section 8.1; docs/sources.md, section
    /// 1.9). It begins at T-1 and ends above 0; where N does not divide T the low end is left out.
    Document,
    /// `(N-1-i) floor(T/N)`: ends at 0, does not reach T-1.
    Leading,
    /// `floor((T-1) (N-1-i) / (N-1))`, in integers; T-1 for N = 1. Both ends (section 7.3).
    #[default]
    Linspace,
    /// `round(T (N-i) / N) - 1`, ties to even: begins at T-1, ends near T/N.
    Trailing,
}

/// Where the last step of DDIM lands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinalAlpha {
    /// On timestep 0, whose noise stays in the sample: `abar[0]` (section 8.1).
    First,
    /// On the clean motion: `abar = 1` (section 7.3).
    #[default]
    One,
}

/// A sampler (CC-MotionGen, sections 3.2.1 and 8.1; docs/sources.md, section 1.9).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SamplerConfig {
    /// The sampling algorithm.
    pub kind: SamplerKind,
    /// Number of steps N, from 1 to the process's number of timesteps T.
    pub num_inference_steps: usize,
    /// Scale of the noise added by DDIM, from 0 (deterministic) to 1 (as DDPM).
    pub eta: f64,
    /// Classifier-free guidance scale; 1 disables guidance.
    pub guidance_scale: f64,
    /// Guidance scale of the style, for models with one (`model.style`); if not set, the same as
    /// `guidance_scale`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style_guidance_scale: Option<f64>,
    /// Largest error of a step of `dopri5`, of a number of size 1; without it steps are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Timestep below which no guidance scale is more than 1. Guidance multiplies what the network gets
    /// wrong, and what it gets wrong at low noise is how a motion shakes; what a motion is has been
    /// decided by then (Kynkäänniemi et al. 2024, <https://arxiv.org/abs/2404.07724>). 0 guides at
    /// all timesteps.
    pub guidance_until: usize,
    /// Spacing of the timesteps.
    pub timestep_spacing: TimestepSpacing,
    /// Where DDIM's last step lands; other samplers end at the clean motion.
    pub final_alpha: FinalAlpha,
    /// After clipping the predicted motion, DDIM goes on with the noise that belongs to the
    /// clipped one; the source goes on with the network's, which then contradicts it.
    pub recompute_epsilon: bool,
}

impl Default for SamplerConfig {
    fn default() -> Self {
        Self {
            kind: SamplerKind::default(),
            num_inference_steps: 20,
            eta: 0.0,
            guidance_scale: 1.0,
            style_guidance_scale: None,
            guidance_until: 0,
            tolerance: None,
            timestep_spacing: TimestepSpacing::default(),
            final_alpha: FinalAlpha::default(),
            recompute_epsilon: true,
        }
    }
}

impl SamplerConfig {
    /// Rejects values that no sampler of a process with `num_train_timesteps` can work with.
    ///
    /// # Errors
    /// Names the first bad key: what it is, what is allowed, how to mend it.
    pub fn validate(&self, num_train_timesteps: usize) -> Result<(), InvalidSetting> {
        require(
            (1..=num_train_timesteps).contains(&self.num_inference_steps),
            "sampling.sampler.num_inference_steps",
            self.num_inference_steps,
            format!("1 to diffusion.num_train_timesteps ({num_train_timesteps})"),
        )
        .hint("20 to 50 are usual for ddim")?;
        in_range("sampling.sampler.eta", self.eta, 0.0..=1.0)
            .hint("0 adds no noise, 1 as much as ddpm")?;
        in_range(
            "sampling.sampler.guidance_scale",
            self.guidance_scale,
            0.0..,
        )
        .hint("1 is the condition as trained; 2 to 3 exaggerate it")?;
        in_range(
            "sampling.sampler.style_guidance_scale",
            self.style_guidance_scale.unwrap_or(1.0),
            0.0..,
        )
        .hint("leave it out for the same as `guidance_scale`")?;
        require(
            (0..=num_train_timesteps).contains(&self.guidance_until),
            "sampling.sampler.guidance_until",
            self.guidance_until,
            format!("0 to diffusion.num_train_timesteps ({num_train_timesteps})"),
        )
        .hint("0 guides at all timesteps")
    }

    /// The guidance scales of the conditions at a timestep.
    pub fn guidance(&self, timestep: usize) -> GuidanceScales {
        // A scale up to 1 multiplies nothing, and 0 stays the unconditional prediction.
        let most = match timestep < self.guidance_until {
            true => 1.0,
            false => f64::INFINITY,
        };
        let style = self.style_guidance_scale.map(|scale| scale.min(most));
        GuidanceScales::new(self.guidance_scale.min(most), style)
    }

    /// Where the last step lands: a timestep, or `None` for the clean motion.
    pub(super) fn last_landing(&self) -> Option<usize> {
        match (self.kind, self.final_alpha) {
            (SamplerKind::Ddim, FinalAlpha::First) => Some(0),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_table_is_the_default_and_valid() {
        let config: SamplerConfig = serde_json::from_str("{}").unwrap();
        assert_eq!(config, SamplerConfig::default());
        config.validate(1000).unwrap();
    }

    #[test]
    fn names_are_read_as_documented() {
        let config: SamplerConfig = serde_json::from_str(
            r#"{"kind": "ddpm", "timestep_spacing": "linspace", "final_alpha": "one"}"#,
        )
        .unwrap();
        assert_eq!(config.kind, SamplerKind::Ddpm);
        assert_eq!(config.timestep_spacing, TimestepSpacing::Linspace);
        assert_eq!(config.final_alpha, FinalAlpha::One);
        assert!(serde_json::from_str::<SamplerConfig>(r#"{"steps": 20}"#).is_err());
    }

    #[test]
    fn guidance_ends_below_its_timestep() {
        let config = SamplerConfig {
            guidance_scale: 2.5,
            style_guidance_scale: Some(0.5),
            guidance_until: 30,
            ..SamplerConfig::default()
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
        let base = SamplerConfig::default;
        let cases = [
            (
                SamplerConfig {
                    num_inference_steps: 0,
                    ..base()
                },
                "num_inference_steps` is 0",
            ),
            (
                SamplerConfig {
                    num_inference_steps: 51,
                    ..base()
                },
                "num_inference_steps` is 51",
            ),
            (
                SamplerConfig {
                    eta: -0.1,
                    ..base()
                },
                "eta` is -0.1",
            ),
            (SamplerConfig { eta: 1.5, ..base() }, "eta` is 1.5"),
            (
                SamplerConfig {
                    eta: f64::NAN,
                    ..base()
                },
                "eta` is NaN",
            ),
            (
                SamplerConfig {
                    guidance_scale: -1.0,
                    ..base()
                },
                "guidance_scale` is -1",
            ),
            (
                SamplerConfig {
                    style_guidance_scale: Some(-0.5),
                    ..base()
                },
                "style_guidance_scale` is -0.5",
            ),
            (
                SamplerConfig {
                    guidance_scale: f64::INFINITY,
                    ..base()
                },
                "guidance_scale` is inf",
            ),
            (
                SamplerConfig {
                    guidance_until: 51,
                    ..base()
                },
                "guidance_until` is 51",
            ),
        ];
        for (config, start) in cases {
            let text = config.validate(50).unwrap_err().to_string();
            assert!(
                text.starts_with(&format!("`sampling.sampler.{start}, allowed: ")),
                "{text}"
            );
        }
        SamplerConfig {
            num_inference_steps: 50,
            ..base()
        }
        .validate(50)
        .unwrap();
        SamplerConfig {
            num_inference_steps: 1,
            eta: 1.0,
            guidance_until: 50,
            ..base()
        }
        .validate(50)
        .unwrap();
    }
}
