//! The cosine schedule and its respaced process.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    ClipRange, Ddpm, Prediction, PredictionType, SamplerConfig, SamplerKind, TimestepSpacing,
    Timesteps, VarianceType, ddpm_step, timesteps,
};
use kinegrad_tests::golden::{Golden, values, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::bench::process;

/// Relative, for tables computed in f64.
const TOLERANCE: f64 = 1e-12;

/// Absolute, if the reference subtracts a number near 1 from 1.
const CANCELLED: f64 = 1e-15;

/// Relative, for factors rounded to single precision.
const SINGLE: f64 = 1e-6;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd_schedule("gmd/schedule_cosine1000.safetensors"),
        golden_gmd_schedule_respaced("gmd/schedule_cosine1000.safetensors"),
    ]
}

fn same(golden: &Golden, name: &str, values: &[f64]) {
    let reference = golden.get(name);
    reference.assert_within_f64(name, values, 0.0, TOLERANCE);
}

fn golden_gmd_schedule(golden: Golden) {
    let schedule = process(PredictionType::Sample).schedule;
    let same = |name: &str, values: &[f64]| same(&golden, name, values);
    same("out.betas_initial", &schedule.betas);
    same("out.alphas_cumprod", &schedule.alphas_cumprod);
    same("out.alphas_cumprod_prev", &schedule.alphas_cumprod_prev);
    let next = schedule.alphas_cumprod.iter().skip(1).chain([&0.0]);
    let next: Vec<f64> = next.copied().collect();
    same("out.alphas_cumprod_next", &next);
    same("out.sqrt_alphas_cumprod", &schedule.sqrt_alphas_cumprod);
    let noise = &schedule.sqrt_one_minus_alphas_cumprod;
    same("out.sqrt_one_minus_alphas_cumprod", noise);
    same(
        "out.sqrt_recip_alphas_cumprod",
        &schedule.sqrt_recip_alphas_cumprod,
    );
    same(
        "out.sqrt_recipm1_alphas_cumprod",
        &schedule.sqrt_recipm1_alphas_cumprod,
    );
    same("out.posterior_mean_coef1", &schedule.posterior_mean_coef1);
    same("out.posterior_mean_coef2", &schedule.posterior_mean_coef2);
    same("out.posterior_variance", &schedule.posterior_variance);
    // The variance of timestep 0 is 0: the reference takes the next one's logarithm there.
    let variance = &schedule.posterior_variance;
    let logarithms: Vec<f64> = [variance[1]]
        .iter()
        .chain(&variance[1..])
        .map(|v| v.ln())
        .collect();
    same("out.posterior_log_variance_clipped", &logarithms);
    let logarithms = schedule.one_minus_alphas_cumprod.iter().map(|v| v.ln());
    golden.compare(
        "out.log_one_minus_alphas_cumprod",
        &logarithms.collect::<Vec<f64>>(),
        TOLERANCE,
    );
    // Made anew from the cumulative products.
    let products = schedule
        .alphas_cumprod
        .iter()
        .zip(&schedule.alphas_cumprod_prev);
    let betas: Vec<f64> = products.map(|(abar, before)| 1.0 - abar / before).collect();
    golden.compare("out.betas", &betas, CANCELLED);

    // Equations 1 and 2 of the appendix.
    let (a, b) = (
        &schedule.posterior_mean_coef1,
        &schedule.posterior_mean_coef2,
    );
    same("out.coef_a_x0", a);
    same("out.coef_b_xt", b);
    let of_both = |value: &dyn Fn(usize) -> f64| (0..a.len()).map(value).collect::<Vec<f64>>();
    let (root, abar) = (&schedule.sqrt_alphas_cumprod, &schedule.alphas_cumprod);
    let substituted = of_both(&|t| a[t] / root[t] + b[t]);
    same("out.coef_c_eps_xt", &substituted);
    same("out.coef_d_eps", &of_both(&|t| a[t] * noise[t] / root[t]));
    // The formula printed in the appendix, which differs from the substitution.
    let printed = of_both(&|t| a[t] / abar[t] + b[t]);
    same("out.coef_c_literal", &printed);
    let mut both = printed.iter().zip(&substituted);
    assert!(both.all(|(printed, substituted)| printed > substituted));
}

/// Every tenth timestep, as a process of its own.
fn golden_gmd_schedule_respaced(golden: Golden) {
    let diffusion = process(PredictionType::Sample);
    let schedule = &diffusion.schedule;
    let map = golden.get("out.ddim100_timestep_map").values;
    let respaced = Timesteps {
        timestep_spacing: TimestepSpacing::Leading,
        guidance_until: 0,
    };
    let respaced = SamplerConfig::new(SamplerKind::Ddpm(respaced.into()), map.len());
    let mut kept = timesteps(&respaced, schedule.num_train_timesteps());
    kept.reverse();
    let found: Vec<f64> = kept.iter().map(|&t| t as f64).collect();
    golden.compare_exactly("out.ddim100_timestep_map", &found);

    let before: Vec<Option<usize>> = [None]
        .into_iter()
        .chain(kept.iter().copied().map(Some))
        .take(kept.len())
        .collect();
    let landings = |at: Vec<Option<usize>>| -> Vec<f64> {
        at.into_iter().map(|t| schedule.abar_at(t).0).collect()
    };
    let abar = landings(kept.iter().copied().map(Some).collect());
    let abar_before = landings(before.clone());
    same(&golden, "out.ddim100_alphas_cumprod", &abar);
    let products = abar.iter().zip(&abar_before);
    let betas: Vec<f64> = products.map(|(abar, before)| 1.0 - abar / before).collect();
    golden.compare("out.ddim100_betas", &betas, CANCELLED);

    // Steps of all jumps at once, on a motion, a state or a noise of 1 alone, are their factors.
    let device = Device::flex();
    let shape = [kept.len(), 1, 1];
    let step = |motion: f64, state: f64, noise: f64, config: Ddpm| -> Vec<f64> {
        let full = |value: f64| Tensor::<3>::full(shape, value, &device);
        let (motion, state, noise) = (full(motion), full(state), Some(full(noise)));
        let prediction = Prediction::new(&diffusion, motion, state, &kept, &ClipRange::None);
        let prediction = prediction.expect("sizes that fit");
        let noises = [noise, None];
        let sample = ddpm_step(&diffusion, &prediction, &kept, &before, noises, &config);
        wide(&values(sample))
    };
    let factor = |motion, state, noise| step(motion, state, noise, Ddpm::default());
    let stored = golden.get("out.ddim100_posterior_variance");
    let variance: Vec<f64> = factor(0.0, 0.0, 1.0).iter().map(|v| v * v).collect();
    stored.assert_within_f64("variance of a jump", &variance, 0.0, SINGLE);
    // The larger variance is the beta of the jump, and 0 at the end.
    let fixed_large = Ddpm {
        variance_type: VarianceType::FixedLarge,
        ..Ddpm::default()
    };
    let large = step(0.0, 0.0, 1.0, fixed_large);
    let large: Vec<f64> = large.iter().map(|v| v * v).collect();
    let mut expected = golden.get("out.ddim100_betas").values;
    expected[0] = 0.0;
    golden.compare_lists("larger variance", &large, &expected, SINGLE);
    // The factors of the motion and the state, from the reference's own tables.
    let stored = |name: &str| golden.get(&format!("out.ddim100_{name}")).values;
    let (abar, betas) = (stored("alphas_cumprod"), stored("betas"));
    let of_motion = |i: usize| match i {
        0 => 1.0,
        _ => betas[i] * abar[i - 1].sqrt() / (1.0 - abar[i]),
    };
    let of_state = |i: usize| match i {
        0 => 0.0,
        _ => (1.0 - betas[i]).sqrt() * (1.0 - abar[i - 1]) / (1.0 - abar[i]),
    };
    for (what, found, expected) in [
        (
            "motion",
            factor(1.0, 0.0, 0.0),
            (0..kept.len()).map(of_motion).collect(),
        ),
        (
            "state",
            factor(0.0, 1.0, 0.0),
            (0..kept.len()).map(of_state).collect::<Vec<f64>>(),
        ),
    ] {
        golden.compare_lists(&format!("factor of the {what}"), &found, &expected, SINGLE);
    }
}
