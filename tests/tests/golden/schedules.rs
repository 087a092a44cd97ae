//! Golden file 01: every schedule table in f64, and the timesteps of golden file 08.

use kinegrad_diffusion::{
    BetaSchedule, DiffusionConfig, NoiseSchedule, SamplerConfig, SamplerKind, TimestepSpacing,
    Timesteps, timesteps,
};
use kinegrad_tests::golden::Golden;
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// Relative, for tables computed in f64 (docs/sources.md, section 1.2).
const TOLERANCE: f64 = 1e-12;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_schedules_match_in_double_precision("ccmotion/01_schedules.safetensors"),
        golden_timesteps_match_exactly("ccmotion/08_ddim.safetensors"),
    ]
}

/// The number after a one-letter prefix: `T1000` is 1000.
fn number(part: &str) -> usize {
    part[1..].parse().expect("a number after the letter")
}

fn golden_schedules_match_in_double_precision(golden: Golden) {
    let beta = |key| golden.metadata(key).parse::<f64>().expect("a number");
    for name in golden.names_under("out.") {
        let [schedule, total, table] = name
            .split('.')
            .collect::<Vec<_>>()
            .try_into()
            .expect("schedule, T and table");
        let config = DiffusionConfig {
            num_train_timesteps: number(total),
            beta_schedule: serde_json::from_value::<BetaSchedule>(schedule.into())
                .expect("a known schedule"),
            beta_start: beta("beta_start"),
            beta_end: beta("beta_end"),
            ..Default::default()
        };
        let tables = NoiseSchedule::new(&config).expect("a valid config");
        let actual = match table {
            "betas" => &tables.betas,
            "alphas" => &tables.alphas,
            "alphas_cumprod" => &tables.alphas_cumprod,
            "alphas_cumprod_prev" => &tables.alphas_cumprod_prev,
            "sqrt_alphas_cumprod" => &tables.sqrt_alphas_cumprod,
            "sqrt_one_minus_alphas_cumprod" => &tables.sqrt_one_minus_alphas_cumprod,
            "sqrt_recip_alphas_cumprod" => &tables.sqrt_recip_alphas_cumprod,
            "sqrt_recipm1_alphas_cumprod" => &tables.sqrt_recipm1_alphas_cumprod,
            "posterior_mean_coef1" => &tables.posterior_mean_coef1,
            "posterior_mean_coef2" => &tables.posterior_mean_coef2,
            "posterior_variance" => &tables.posterior_variance,
            other => panic!("a table of another name: {other}"),
        };
        let reference = golden.get(&format!("out.{name}"));
        reference.assert_close(&name, actual, TOLERANCE);
    }
}

/// `out.timesteps_8_1` is the spacing `ccmotion`, `out.timesteps_7_3` is `linspace`.
fn golden_timesteps_match_exactly(golden: Golden) {
    for (section, timestep_spacing) in [
        ("8_1", TimestepSpacing::CcMotion),
        ("7_3", TimestepSpacing::Linspace),
    ] {
        let prefix = format!("out.timesteps_{section}.");
        for case in golden.names_under(&prefix) {
            let (total, steps) = case.split_once('.').expect("T and N");
            let config = Timesteps {
                timestep_spacing,
                guidance_until: 0,
            };
            let config = SamplerConfig::new(SamplerKind::Ddpm(config.into()), number(steps));
            let found = timesteps(&config, number(total));
            let found: Vec<f64> = found.into_iter().map(|t| t as f64).collect();
            golden.compare_exactly(&format!("{prefix}{case}"), &found);
        }
    }
}
