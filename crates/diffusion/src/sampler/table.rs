//! Reading a sampler's settings from a table.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::config::{
    Ddim, Ddpm, Dopri5, FinalAlpha, SamplerConfig, SamplerKind, TimestepSpacing, Timesteps,
    VarianceType,
};

/// The names of [`SamplerKind`].
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    #[default]
    Ddim,
    Ddpm,
    #[serde(rename = "dpmpp_2m")]
    Dpmpp2m,
    Heun,
    Euler,
    Midpoint,
    Dopri5,
}

/// The keys of all kinds, so that errors can suggest any of them.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Table {
    kind: Kind,
    num_inference_steps: usize,
    guidance_scale: f64,
    style_guidance_scale: Option<f64>,
    timestep_spacing: TimestepSpacing,
    guidance_until: usize,
    eta: f64,
    final_alpha: FinalAlpha,
    recompute_epsilon: bool,
    variance_type: VarianceType,
    tolerance: Option<f64>,
}

impl Default for Table {
    fn default() -> Self {
        let (usual, ddim) = (SamplerConfig::default(), Ddim::default());
        Self {
            kind: Kind::default(),
            num_inference_steps: usual.num_inference_steps,
            guidance_scale: usual.guidance_scale,
            style_guidance_scale: usual.style_guidance_scale,
            timestep_spacing: ddim.timesteps.timestep_spacing,
            guidance_until: ddim.timesteps.guidance_until,
            eta: ddim.eta,
            final_alpha: ddim.final_alpha,
            recompute_epsilon: ddim.recompute_epsilon,
            variance_type: VarianceType::default(),
            tolerance: None,
        }
    }
}

impl Table {
    /// Rejects keys of other kinds unless they have their default value. A saved config contains
    /// all keys of its kind, and `--set` may change the kind.
    fn refuse_keys_of_other_kinds(&self) -> Result<(), String> {
        let usual = Self::default();
        let is_ddim = matches!(self.kind, Kind::Ddim);
        let is_ddpm = matches!(self.kind, Kind::Ddpm);
        let is_dopri5 = matches!(self.kind, Kind::Dopri5);
        let visits = is_ddim || is_ddpm || matches!(self.kind, Kind::Dpmpp2m | Kind::Heun);
        let spaced = self.timestep_spacing != usual.timestep_spacing;
        let recomputes = self.recompute_epsilon != usual.recompute_epsilon;
        let keys = [
            ("kind", true, true),
            ("num_inference_steps", true, true),
            ("guidance_scale", true, true),
            ("style_guidance_scale", true, true),
            ("timestep_spacing", visits, spaced),
            (
                "guidance_until",
                visits,
                self.guidance_until != usual.guidance_until,
            ),
            ("eta", is_ddim, self.eta != usual.eta),
            (
                "final_alpha",
                is_ddim,
                self.final_alpha != usual.final_alpha,
            ),
            ("recompute_epsilon", is_ddim, recomputes),
            (
                "variance_type",
                is_ddpm,
                self.variance_type != usual.variance_type,
            ),
            ("tolerance", is_dopri5, self.tolerance.is_some()),
        ];
        let Some((key, ..)) = keys.iter().find(|(_, own, set)| *set && !own) else {
            return Ok(());
        };
        let own = keys.iter().filter(|(_, own, _)| *own);
        let own: Vec<String> = own.map(|(key, ..)| format!("`{key}`")).collect();
        // The wording of serde for an unknown key.
        Err(format!(
            "unknown field `{key}`, expected one of {}",
            own.join(", ")
        ))
    }
}

impl<'de> Deserialize<'de> for SamplerConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = Table::deserialize(deserializer)?;
        table
            .refuse_keys_of_other_kinds()
            .map_err(D::Error::custom)?;
        let timesteps = Timesteps {
            timestep_spacing: table.timestep_spacing,
            guidance_until: table.guidance_until,
        };
        Ok(Self {
            kind: match table.kind {
                Kind::Ddim => SamplerKind::Ddim(Ddim {
                    timesteps,
                    eta: table.eta,
                    final_alpha: table.final_alpha,
                    recompute_epsilon: table.recompute_epsilon,
                }),
                Kind::Ddpm => SamplerKind::Ddpm(Ddpm {
                    timesteps,
                    variance_type: table.variance_type,
                }),
                Kind::Dpmpp2m => SamplerKind::Dpmpp2m(timesteps),
                Kind::Heun => SamplerKind::Heun(timesteps),
                Kind::Euler => SamplerKind::Euler,
                Kind::Midpoint => SamplerKind::Midpoint,
                Kind::Dopri5 => SamplerKind::Dopri5(Dopri5 {
                    tolerance: table.tolerance,
                }),
            },
            num_inference_steps: table.num_inference_steps,
            guidance_scale: table.guidance_scale,
            style_guidance_scale: table.style_guidance_scale,
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn read(table: Value) -> Result<SamplerConfig, String> {
        serde_json::from_value(table).map_err(|error| error.to_string())
    }

    #[test]
    fn an_empty_table_is_the_default() {
        assert_eq!(read(json!({})), Ok(SamplerConfig::default()));
    }

    #[test]
    fn each_kind_is_read_with_its_own_keys_and_written_with_them() {
        for table in [
            json!({"kind": "ddim", "eta": 0.5, "final_alpha": "first", "recompute_epsilon": false,
                "timestep_spacing": "ccmotion", "guidance_until": 7}),
            json!({"kind": "ddpm", "timestep_spacing": "leading", "guidance_until": 7,
                "variance_type": "fixed_large"}),
            json!({"kind": "dpmpp_2m", "timestep_spacing": "linspace", "guidance_until": 0}),
            json!({"kind": "heun", "timestep_spacing": "trailing", "guidance_until": 7}),
            json!({"kind": "euler"}),
            json!({"kind": "midpoint"}),
            json!({"kind": "dopri5", "tolerance": 0.01}),
            json!({"kind": "dopri5"}),
        ] {
            let mut table = table;
            for (key, value) in [
                ("num_inference_steps", json!(9)),
                ("guidance_scale", json!(2.0)),
                ("style_guidance_scale", json!(3.0)),
            ] {
                table[key] = value;
            }
            let config = read(table.clone()).expect("its own keys");
            assert_eq!(config.kind.to_string(), table["kind"]);
            assert_eq!(serde_json::to_value(&config).expect("JSON"), table);
        }
    }

    #[test]
    fn keys_of_other_kinds_are_refused_by_name() {
        for (table, key) in [
            (json!({"kind": "ddpm", "eta": 0.5}), "eta"),
            (json!({"variance_type": "fixed_large"}), "variance_type"),
            (
                json!({"kind": "heun", "final_alpha": "first"}),
                "final_alpha",
            ),
            (
                json!({"kind": "dpmpp_2m", "recompute_epsilon": false}),
                "recompute_epsilon",
            ),
            (
                json!({"kind": "euler", "timestep_spacing": "leading"}),
                "timestep_spacing",
            ),
            (
                json!({"kind": "midpoint", "guidance_until": 3}),
                "guidance_until",
            ),
            (json!({"tolerance": 0.1}), "tolerance"),
            (json!({"steps": 20}), "steps"),
        ] {
            let error = read(table).expect_err(key);
            let start =
                format!("unknown field `{key}`, expected one of `kind`, `num_inference_steps`");
            assert!(error.starts_with(&start), "{error}");
        }
        let error = read(json!({"kind": "ddpm", "eta": 0.5})).expect_err("eta");
        assert!(
            error.contains("`guidance_until`") && !error.contains("`tolerance`"),
            "{error}"
        );
        assert!(read(json!({"kind": "dopri"})).is_err());
    }

    #[test]
    fn keys_of_other_kinds_pass_with_their_default() {
        let table = json!({"kind": "ddpm", "num_inference_steps": 20, "eta": 0.0,
            "guidance_scale": 1.0, "guidance_until": 0, "timestep_spacing": "linspace",
            "final_alpha": "one", "recompute_epsilon": true});
        let ddpm = SamplerKind::Ddpm(Ddpm::default());
        assert_eq!(read(table), Ok(SamplerConfig::new(ddpm, 20)));
    }
}
