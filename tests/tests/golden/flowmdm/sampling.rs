//! The timesteps with relative positions, and complete sampling.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{Composed, Switch};
use kinegrad_diffusion::{
    ClipRange, Ddpm, Denoiser as _, Prediction, PredictionType, Time, ddpm_step, guided,
};
use kinegrad_tests::golden::{Golden, ReferenceTensors as _, values};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::super::gmd::bench::process;
use super::drawing::{Drawing, composition};
use super::{motions, switch};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_blended_schedule("flowmdm/schedule_bpe.safetensors"),
        golden_composition_sampling("flowmdm/composition_sampling.safetensors"),
    ]
}

fn golden_blended_schedule(golden: Golden) {
    let diffusion = process(PredictionType::Sample);
    let schedule = &diffusion.schedule;
    let same = |name: &str, values: &[f64]| {
        golden
            .get(name)
            .assert_within_f64(name, values, 1e-12, 1e-12);
    };
    same("out.betas_initial", &schedule.betas);
    same("out.alphas_cumprod", &schedule.alphas_cumprod);
    same("out.alphas_cumprod_prev", &schedule.alphas_cumprod_prev);
    same("out.sqrt_alphas_cumprod", &schedule.sqrt_alphas_cumprod);
    same(
        "out.sqrt_one_minus_alphas_cumprod",
        &schedule.sqrt_one_minus_alphas_cumprod,
    );
    same("out.posterior_mean_coef1", &schedule.posterior_mean_coef1);
    same("out.posterior_mean_coef2", &schedule.posterior_mean_coef2);
    same("out.posterior_variance", &schedule.posterior_variance);
    let steps = golden.get("in.bpe_step").values;
    let of = |k: f64| Switch {
        bpe_denoising_step: k as i64,
        num_train_timesteps: 1000,
    };
    let relative = |k: f64| (0..1000).map(move |t| f64::from(u8::from(of(k).is_relative(t))));
    let flags: Vec<f64> = steps.iter().flat_map(|&k| relative(k)).collect();
    golden.compare_exactly("out.is_relative", &flags);
    let absolute: Vec<f64> = steps
        .iter()
        .map(|&k| 1000.0 - relative(k).sum::<f64>())
        .collect();
    golden.compare_exactly("out.absolute_steps", &absolute);
    let ratio = golden.get("in.train_ratio").scalar();
    for (input, output, ratio) in [
        ("in.train_uniform", "out.train_is_relative", ratio),
        ("in.train_uniform_r03", "out.train_is_relative_r03", 0.3),
    ] {
        let drawn = golden.get(input).values;
        let flags = drawn.iter().map(|u| f64::from(u8::from(*u < ratio)));
        golden.compare_exactly(output, &flags.collect::<Vec<f64>>());
    }
    // Respaced processes: the products at the timesteps that are kept.
    for steps in [25, 50] {
        let kept = golden
            .get(&format!("out.respaced{steps}.timestep_map"))
            .indices();
        let products: Vec<f64> = kept.iter().map(|&t| schedule.alphas_cumprod[t]).collect();
        same(&format!("out.respaced{steps}.alphas_cumprod"), &products);
    }
}

fn compare_each(golden: &Golden, name: &str, from: usize, found: &[Tensor<3>], tolerance: f64) {
    let reference = golden.get(name);
    assert_eq!(reference.shape[0], found.len() + from, "{name}: steps");
    for (index, found) in found.iter().enumerate() {
        let expected = reference.part(index + from);
        let expected_size: usize = expected.values.len();
        let found = values(found.clone());
        assert_eq!(found.len(), expected_size, "{name}");
        expected.assert_within_f32(name, &found, tolerance, 0.0);
    }
}

fn golden_composition_sampling(golden: Golden) {
    let (network, script, text, scale) = composition(&golden);
    let device = Device::flex();
    let switch = switch(&golden);
    let composed = |bpe_denoising_step: i64| Composed {
        network: &network,
        path: None,
        path_guidance_scale: 1.0,
        segments: script.clone(),
        switch: Switch {
            bpe_denoising_step,
            ..switch
        },
    };
    let published = composed(switch.bpe_denoising_step);
    let drawing = Drawing {
        golden: &golden,
        composed: &published,
        text: text.clone(),
        scale,
    };
    // Single steps.
    let diffusion = process(PredictionType::Sample);
    let x_t = motions(&golden, "in.step.x_t", &device);
    for (index, t) in golden.get("in.step.t").indices().into_iter().enumerate() {
        let time = Time::of(&[t]);
        let part = |name: &str| golden.get(&format!("out.step.{name}")).part(index);
        let cond = published.predict(x_t.clone(), &time, &text);
        let uncond = published.predict(x_t.clone(), &time, &published.null_cond(&text));
        let x_start = guided(&published, x_t.clone(), &time, &text, scale);
        let noise = golden.get("in.step.noise").part(index).f32s();
        let noise = Tensor::from_data(TensorData::new(noise, x_t.dims()), &device);
        let prediction = Prediction::new(
            &diffusion,
            x_start.clone(),
            x_t.clone(),
            &[t],
            &ClipRange::None,
        );
        let prediction = prediction.expect("sizes fit");
        let before = [t.checked_sub(1)];
        let step = |noise| {
            let ddpm = Ddpm::default();
            ddpm_step(&diffusion, &prediction, &[t], &before, [noise, None], &ddpm)
        };
        let mean = step(None);
        let sample = step(Some(noise));
        for (name, found) in [
            ("cond", cond),
            ("uncond", uncond),
            ("pred_xstart", x_start),
            ("mean", mean),
            ("sample", sample),
        ] {
            part(name).assert_within_f32(name, &values(found), 1e-3, 0.0);
        }
    }
    // Consecutive steps across the switch, and the last ones.
    for (name, tolerance) in [("around_switch", 2e-5), ("last", 1e-3)] {
        let start = motions(&golden, &format!("in.{name}.x"), &device);
        let timesteps = golden.get(&format!("in.{name}.t")).indices();
        // A complete path ends at clean motion. Here the last step ends at the next timestep, so
        // the path has one more.
        let mut path = timesteps.clone();
        if let Some(next) = timesteps.last().and_then(|t| t.checked_sub(1)) {
            path.push(next);
        }
        let [states, _] =
            drawing.around(start, &path, timesteps.len(), &format!("in.{name}.noise"));
        compare_each(
            &golden,
            &format!("out.{name}.states"),
            1,
            &states,
            tolerance,
        );
    }
    // Complete sampling with 25 steps.
    let timesteps = golden.get("in.respaced25.t").indices();
    let start = motions(&golden, "in.respaced25.noise_start", &device);
    let run = |composed: &Composed<'_>, scale: f64| {
        let drawing = Drawing {
            golden: &golden,
            composed,
            text: text.clone(),
            scale,
        };
        drawing.along(start.clone(), &timesteps, "in.respaced25.noise")
    };
    let [states, predicted] = run(&published, scale);
    compare_each(&golden, "out.respaced25.bpe.states", 0, &states, 3e-3);
    compare_each(
        &golden,
        "out.respaced25.bpe.pred_xstart",
        0,
        &predicted,
        3e-3,
    );
    for (name, step, scale) in [
        ("all_absolute", -1, scale),
        ("all_relative", 0, scale),
        ("chunked", switch.bpe_denoising_step, scale),
        ("no_guidance", switch.bpe_denoising_step, 1.0),
    ] {
        let [states, _] = run(&composed(step), scale);
        let name = format!("out.respaced25.{name}.final");
        let last = states.last().expect("steps").clone();
        golden
            .get(&name)
            .flat()
            .assert_within(&name, last, 3e-3, 0.0);
    }
}
