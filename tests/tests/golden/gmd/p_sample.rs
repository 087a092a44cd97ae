//! Steps of the process with the toy denoiser, unsteered.

use kinegrad_diffusion::{PredictionType, Steering};
use kinegrad_tests::golden::{Golden, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::bench::Bench;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd_p_sample("gmd/p_sample.safetensors"),
        golden_gmd_q_sample_and_posterior("gmd/p_sample.safetensors"),
    ]
}

fn golden_gmd_p_sample(golden: Golden) {
    for (kind, prediction_type) in [
        ("x0", PredictionType::Sample),
        ("eps", PredictionType::Epsilon),
    ] {
        let bench = Bench::new(&golden, "model.", prediction_type);
        let timesteps = bench.timesteps();
        let none = Steering::default();
        for (index, &timestep) in timesteps.iter().enumerate() {
            let at = |name: &str| bench.part(&format!("out.{kind}.{name}"), index);
            let noise = Some(bench.part("in.noise", index).tensor(&bench.device));
            let x_t = bench.input("in.x_t");
            let step = bench.step(x_t.clone(), timestep, noise, None, &none);
            at("sample").assert_within("sample", step.prev_sample, 1e-5, 0.0);
            let x_start = step.pred_original_sample;
            at("pred_xstart").assert_within("pred_xstart", x_start, 1e-5, 0.0);
            let mean = bench.step(x_t, timestep, None, None, &none).prev_sample;
            at("mean").assert_within("mean", mean, 1e-5, 0.0);
        }
        let schedule = &bench.diffusion.schedule;
        let variance = |t: usize| schedule.posterior_variance[t];
        let variances: Vec<f64> = timesteps.iter().map(|&t| variance(t)).collect();
        golden.compare_relative(&format!("out.{kind}.variance"), &variances, 1e-6);
        // That of timestep 0 is 0: the reference takes the next one's logarithm there.
        let logarithms = timesteps.iter().map(|&t| variance(t.max(1)).ln());
        golden.compare(
            &format!("out.{kind}.log_variance"),
            &logarithms.collect::<Vec<f64>>(),
            1e-5,
        );
        let mut x = bench.input("in.x_t");
        for (index, timestep) in (0..6).rev().enumerate() {
            let noise = bench.part(&format!("in.{kind}.loop_noise"), index);
            let noise = Some(noise.tensor(&bench.device));
            x = bench.step(x, timestep, noise, None, &none).prev_sample;
            let expected = bench.part(&format!("out.{kind}.loop"), index);
            expected.assert_within("loop", x.clone(), 1e-5, 0.0);
        }
    }
}

/// The forward process and its posterior, without a network.
fn golden_gmd_q_sample_and_posterior(golden: Golden) {
    let bench = Bench::new(&golden, "model.", PredictionType::Sample);
    let (x_start, x_t) = (bench.input("in.x0"), bench.input("in.x_t"));
    let noise = bench.input("in.noise_q");
    for (index, &timestep) in bench.timesteps().iter().enumerate() {
        let at = vec![timestep; x_start.dims()[0]];
        let noisy = bench
            .diffusion
            .add_noise(x_start.clone(), noise.clone(), &at);
        let (mean, _) = bench.diffusion.posterior(x_start.clone(), x_t.clone(), &at);
        for (name, found) in [("q_sample", noisy), ("q_posterior_mean", mean)] {
            let expected = bench.part(&format!("out.{name}"), index);
            expected.assert_within(&format!("{name} at {timestep}"), found, 1e-5, 0.0);
        }
    }
}
