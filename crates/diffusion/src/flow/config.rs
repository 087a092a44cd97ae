use std::fmt;

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::SamplerConfig;

/// How a flow is followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FlowSolver {
    /// Order 1, one velocity a step.
    #[default]
    Euler,
    /// Order 2, two velocities a step.
    Midpoint,
    /// Order 2, two velocities a step.
    Heun,
    /// Order 5, six velocities a step; with a `tolerance` it chooses its steps itself.
    Dopri5,
}

impl fmt::Display for FlowSolver {
    /// Its name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A solver from noise to data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FlowSamplerConfig {
    /// The solver.
    pub kind: FlowSolver,
    /// Number of equal steps; not read where there is a `tolerance`.
    pub num_inference_steps: usize,
    /// Largest error of a step of `dopri5`, of a number of size 1; without it steps are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Classifier-free guidance scale of the text; 1 disables guidance.
    pub guidance_scale: f64,
}

impl Default for FlowSamplerConfig {
    fn default() -> Self {
        Self {
            kind: FlowSolver::default(),
            num_inference_steps: 10,
            tolerance: None,
            guidance_scale: 1.0,
        }
    }
}

impl FlowSamplerConfig {
    /// What `sampling.sampler` says of a flow, validated.
    ///
    /// # Errors
    /// Names the first key that is not of a flow or has a bad value.
    pub fn of(sampler: &SamplerConfig) -> Result<Self, InvalidSetting> {
        let kind = sampler.kind.flow();
        require(
            kind.is_some(),
            "sampling.sampler.kind",
            format!("\"{}\"", sampler.kind),
            "\"euler\", \"midpoint\", \"heun\" or \"dopri5\" for recipe `flow`",
        )
        .hint("the others are of diffusion processes")?;
        let usual = SamplerConfig::default();
        let nothing = "left out for recipe `flow`: it is of diffusion processes";
        let (eta, until) = (sampler.eta, sampler.guidance_until);
        require(eta == usual.eta, "sampling.sampler.eta", eta, nothing)?;
        let key = "sampling.sampler.guidance_until";
        require(until == usual.guidance_until, key, until, nothing)?;
        let style = sampler.style_guidance_scale;
        let key = "sampling.sampler.style_guidance_scale";
        require(style.is_none(), key, style.unwrap_or_default(), nothing)?;
        for (key, same) in [
            (
                "sampling.sampler.timestep_spacing",
                sampler.timestep_spacing == usual.timestep_spacing,
            ),
            (
                "sampling.sampler.final_alpha",
                sampler.final_alpha == usual.final_alpha,
            ),
            (
                "sampling.sampler.recompute_epsilon",
                sampler.recompute_epsilon == usual.recompute_epsilon,
            ),
        ] {
            require(same, key, "set", nothing)?;
        }
        let config = Self {
            kind: kind.unwrap_or_default(),
            num_inference_steps: sampler.num_inference_steps,
            tolerance: sampler.tolerance,
            guidance_scale: sampler.guidance_scale,
        };
        config.validate()?;
        Ok(config)
    }

    /// Most steps that are not a mistake.
    pub const MAX_STEPS: usize = 10_000;

    /// # Errors
    /// Names the first bad key: what it is, what is allowed, how to mend it.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range(
            "sampling.sampler.num_inference_steps",
            self.num_inference_steps,
            1..=Self::MAX_STEPS,
        )
        .hint("5 to 10 are usual for euler")?;
        if let Some(tolerance) = self.tolerance {
            require(
                self.kind == FlowSolver::Dopri5,
                "sampling.sampler.tolerance",
                tolerance,
                format!("left out with `kind = \"{}\"`", self.kind),
            )
            .hint("only dopri5 chooses its steps; the others take `num_inference_steps`")?;
            in_range("sampling.sampler.tolerance", tolerance, 1e-6..=1.0)
                .hint("1e-3 to 1e-5 are usual in single precision")?;
        }
        in_range(
            "sampling.sampler.guidance_scale",
            self.guidance_scale,
            0.0..,
        )
        .hint("1 is the text as trained; 2 to 3 exaggerate it")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_table_is_the_default_and_valid() {
        let config: FlowSamplerConfig = serde_json::from_str("{}").unwrap();
        assert_eq!(config, FlowSamplerConfig::default());
        config.validate().unwrap();
        let config: FlowSamplerConfig =
            serde_json::from_str(r#"{"kind": "dopri5", "tolerance": 1e-4}"#).unwrap();
        config.validate().unwrap();
        assert!(serde_json::from_str::<FlowSamplerConfig>(r#"{"steps": 4}"#).is_err());
    }

    #[test]
    fn every_bad_value_is_refused_by_name() {
        let base = FlowSamplerConfig::default;
        let dopri5 = |tolerance| FlowSamplerConfig {
            kind: FlowSolver::Dopri5,
            tolerance: Some(tolerance),
            ..base()
        };
        let steps = |num_inference_steps| FlowSamplerConfig {
            num_inference_steps,
            ..base()
        };
        let guidance = |guidance_scale| FlowSamplerConfig {
            guidance_scale,
            ..base()
        };
        let euler = FlowSamplerConfig {
            tolerance: Some(0.5),
            ..base()
        };
        for (config, start) in [
            (steps(0), "num_inference_steps` is 0"),
            (steps(10_001), "num_inference_steps` is 10001"),
            (dopri5(0.0), "tolerance` is 0"),
            (dopri5(f64::NAN), "tolerance` is NaN"),
            (euler, "tolerance` is 0.5"),
            (guidance(-1.0), "guidance_scale` is -1"),
            (guidance(f64::INFINITY), "guidance_scale` is inf"),
        ] {
            let text = config.validate().unwrap_err().to_string();
            let start = format!("`sampling.sampler.{start}, allowed: ");
            assert!(text.starts_with(&start), "{text}");
        }
    }
}
