//! Golden file 01: every schedule table in f64, and the timesteps of golden file 08.

use kinegrad_diffusion::{
    BetaSchedule, DiffusionConfig, NoiseSchedule, SamplerConfig, TimestepSpacing, timesteps,
};
use kinegrad_tests::golden::Golden;

/// Relative, for tables computed in f64 (docs/sources.md, section 1.2).
const TOLERANCE: f64 = 1e-12;

/// The number after a one-letter prefix: `T1000` is 1000.
fn number(part: &str) -> usize {
    part[1..].parse().expect("a number after the letter")
}

#[test]
fn golden_schedules_match_in_double_precision() {
    let Some(golden) = Golden::open("ccmotion", "01_schedules.safetensors") else {
        return;
    };
    let beta = |key| golden.metadata(key).parse::<f64>().expect("a number");
    let mut worst = 0.0f64;
    let names = golden.names_under("out.");
    assert!(!names.is_empty());
    for name in names {
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
        let error = reference.assert_close(&name, actual, TOLERANCE);
        println!("{name}: {error:.2e}");
        worst = worst.max(error);
    }
    println!("schedules: largest error {worst:.2e}");
}

/// `out.timesteps_8_1` is the spacing `document`, `out.timesteps_7_3` is `linspace`.
#[test]
fn golden_timesteps_match_exactly() {
    let Some(golden) = Golden::open("ccmotion", "08_ddim.safetensors") else {
        return;
    };
    for (section, timestep_spacing) in [
        ("8_1", TimestepSpacing::Document),
        ("7_3", TimestepSpacing::Linspace),
    ] {
        let prefix = format!("out.timesteps_{section}.");
        let cases = golden.names_under(&prefix);
        assert!(!cases.is_empty());
        for case in cases {
            let (total, steps) = case.split_once('.').expect("T and N");
            let config = SamplerConfig {
                num_inference_steps: number(steps),
                timestep_spacing,
                ..Default::default()
            };
            let expected = golden.get(&format!("{prefix}{case}")).indices();
            assert_eq!(
                timesteps(&config, number(total)),
                expected,
                "{section} {case}"
            );
        }
    }
}
