//! Golden file 02 (forward process, DDPM step) and the single DDIM steps of file 08.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    BetaSchedule, ClipRange, Ddim, Ddpm, DiffusionConfig, GaussianDiffusion, Prediction,
    PredictionType, ddim_step, ddpm_step,
};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// docs/sources.md, section 1.3: everything but the predicted motion, which the division by
/// sqrt(abar) amplifies.
const TOLERANCE: f64 = 2e-6;
const TOLERANCE_PRED_ORIGINAL_SAMPLE: f64 = 1e-4;
/// docs/sources.md, section 1.9: single steps.
const TOLERANCE_DDIM_STEP: f64 = 3e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_q_sample("ccmotion/02_diffusion_steps.safetensors"),
        golden_pred_original_sample("ccmotion/02_diffusion_steps.safetensors"),
        golden_posterior_mean("ccmotion/02_diffusion_steps.safetensors"),
        golden_ddpm_step("ccmotion/02_diffusion_steps.safetensors"),
        golden_ddpm_step_by_ddim("ccmotion/02_diffusion_steps.safetensors"),
        golden_ddim_step("ccmotion/08_ddim.safetensors"),
    ]
}

fn process(schedule: &str, prediction: &str, total: usize) -> GaussianDiffusion {
    let config = DiffusionConfig {
        num_train_timesteps: total,
        beta_schedule: serde_json::from_value::<BetaSchedule>(schedule.into())
            .expect("a known schedule"),
        prediction_type: serde_json::from_value::<PredictionType>(prediction.into())
            .expect("a known prediction type"),
        ..Default::default()
    };
    GaussianDiffusion::new(&config).expect("a valid config")
}

/// `noclip`, `clip` (to 1) or `clip` and a number.
fn clip_of(name: &str) -> ClipRange {
    match name.strip_prefix("clip") {
        None => ClipRange::None,
        Some("") => ClipRange::Symmetric(1.0),
        Some(bound) => ClipRange::Symmetric(bound.parse().expect("a number after clip")),
    }
}

struct Steps {
    golden: Golden,
    device: Device,
    total: usize,
}

impl Steps {
    fn of(golden: Golden) -> Self {
        let total = golden.metadata("T").parse().expect("a number");
        Self {
            golden,
            device: Device::flex(),
            total,
        }
    }

    fn tensor(&self, name: &str) -> Tensor<3> {
        self.golden.tensor(name, &self.device)
    }

    fn timesteps(&self, case: &str) -> Vec<usize> {
        self.golden.get(&format!("in.t.{case}")).indices()
    }

    /// Compares each `out.{kind}.{schedule}.{prediction}.{clip}.{timesteps}` with the result of
    /// `actual` for the process, clip, model output, x_t and timesteps of the key.
    fn compare(
        &self,
        kind: &str,
        tolerance: f64,
        actual: impl Fn(&GaussianDiffusion, &ClipRange, Tensor<3>, Tensor<3>, &[usize]) -> Tensor<3>,
    ) {
        for case in self.golden.names_under(&format!("out.{kind}.")) {
            // The clip's bound may contain a point, so parts are taken from both ends.
            let (schedule, rest) = case.split_once('.').expect("schedule");
            let (prediction, rest) = rest.split_once('.').expect("prediction type");
            let (clip, at) = rest.rsplit_once('.').expect("clip and timesteps");
            let diffusion = process(schedule, prediction, self.total);
            let model_output = self.tensor(&format!("in.model_out.{prediction}"));
            let x_t = self.tensor(&format!("out.q_sample.{schedule}.{at}"));
            let found = actual(
                &diffusion,
                &clip_of(clip),
                model_output,
                x_t,
                &self.timesteps(at),
            );
            let reference = self.golden.reference(&format!("out.{kind}.{case}"));
            reference.assert_close_tensor(&format!("{kind}.{case}"), found, tolerance);
        }
    }
}

/// One step down for each sample; from 0 to the clean motion.
fn one_down(timesteps: &[usize]) -> Vec<Option<usize>> {
    timesteps.iter().map(|t| t.checked_sub(1)).collect()
}

fn predicted(
    diffusion: &GaussianDiffusion,
    clip: &ClipRange,
    model_output: Tensor<3>,
    x_t: Tensor<3>,
    timesteps: &[usize],
) -> Prediction<'static> {
    Prediction::new(diffusion, model_output, x_t, timesteps, clip).expect("sizes that fit")
}

fn golden_q_sample(golden: Golden) {
    let steps = Steps::of(golden);
    let (x_start, noise) = (steps.tensor("in.x0"), steps.tensor("in.noise"));
    for case in steps.golden.names_under("out.q_sample.") {
        let (schedule, at) = case.split_once('.').expect("schedule and timesteps");
        let diffusion = process(schedule, "epsilon", steps.total);
        let found = diffusion.add_noise(x_start.clone(), noise.clone(), &steps.timesteps(at));
        let reference = steps.golden.reference(&format!("out.q_sample.{case}"));
        reference.assert_close_tensor(&case, found, TOLERANCE);
    }
}

fn golden_pred_original_sample(golden: Golden) {
    let steps = Steps::of(golden);
    let tolerance = TOLERANCE_PRED_ORIGINAL_SAMPLE;
    steps.compare(
        "p_x0",
        tolerance,
        |diffusion, clip, model_output, x_t, timesteps| {
            let x_start = diffusion.pred_original_sample(model_output, x_t, timesteps);
            clip.apply(x_start).expect("bounds for every channel")
        },
    );
}

/// The posterior mean from the tables of the full process.
fn golden_posterior_mean(golden: Golden) {
    let steps = Steps::of(golden);
    steps.compare(
        "p_mean",
        TOLERANCE,
        |diffusion, clip, model_output, x_t, timesteps| {
            let x_start = diffusion.pred_original_sample(model_output, x_t.clone(), timesteps);
            let x_start = clip.apply(x_start).expect("bounds for every channel");
            diffusion.posterior(x_start, x_t, timesteps).0
        },
    );
}

fn golden_ddpm_step(golden: Golden) {
    let steps = Steps::of(golden);
    let noise = steps.tensor("in.step_noise");
    let step = |diffusion: &GaussianDiffusion, prediction: &Prediction<'_>, at: &[usize], z| {
        let ddpm = Ddpm::default();
        ddpm_step(diffusion, prediction, at, &one_down(at), [z, None], &ddpm)
    };
    steps.compare(
        "p_sample",
        TOLERANCE,
        |diffusion, clip, model_output, x_t, timesteps| {
            let prediction = predicted(diffusion, clip, model_output, x_t, timesteps);
            step(diffusion, &prediction, timesteps, Some(noise.clone()))
        },
    );
    // The same numbers from the jump's cumulative products instead of the tables.
    steps.compare(
        "p_mean",
        TOLERANCE,
        |diffusion, clip, model_output, x_t, timesteps| {
            let prediction = predicted(diffusion, clip, model_output, x_t, timesteps);
            step(diffusion, &prediction, timesteps, None)
        },
    );
    let tolerance = TOLERANCE_PRED_ORIGINAL_SAMPLE;
    steps.compare(
        "p_x0",
        tolerance,
        |diffusion, clip, model_output, x_t, timesteps| {
            predicted(diffusion, clip, model_output, x_t, timesteps).x_start
        },
    );
}

/// DDIM with eta 1 and one timestep per jump samples from the same posterior.
fn golden_ddpm_step_by_ddim(golden: Golden) {
    let steps = Steps::of(golden);
    let noise = steps.tensor("in.step_noise");
    // Its epsilon must belong to the clipped motion, as it does in the posterior.
    let config = Ddim {
        eta: 1.0,
        recompute_epsilon: true,
        ..Default::default()
    };
    steps.compare(
        "p_sample",
        TOLERANCE,
        |diffusion, clip, model_output, x_t, timesteps| {
            let prediction = predicted(diffusion, clip, model_output, x_t, timesteps);
            let (next, noise) = (one_down(timesteps), Some(noise.clone()));
            ddim_step(diffusion, &prediction, timesteps, &next, noise, &config)
        },
    );
}

/// `out.step.eta{eta}.t{from}_{to}.{clip}` of file 08: the cosine schedule of 1000 timesteps.
fn golden_ddim_step(golden: Golden) {
    let device = Device::flex();
    let input = |name: &str| golden.tensor::<3>(&format!("in.step.{name}"), &device);
    let diffusion = process("cosine", "epsilon", 1000);
    for case in golden.names_under("out.step.eta") {
        let (rest, clip) = case.rsplit_once('.').expect("clip");
        let (eta, jump) = rest.rsplit_once(".t").expect("eta and timesteps");
        let (from, to) = jump.split_once('_').expect("two timesteps");
        let (from, to): (usize, usize) = (from.parse().unwrap(), to.parse().unwrap());
        let config = Ddim {
            eta: eta.parse().unwrap(),
            recompute_epsilon: false,
            ..Default::default()
        };
        let x_t = input("x");
        let batch = x_t.dims()[0];
        let (now, next) = (vec![from; batch], vec![Some(to); batch]);
        let prediction = predicted(&diffusion, &clip_of(clip), input("eps"), x_t, &now);
        let found = ddim_step(
            &diffusion,
            &prediction,
            &now,
            &next,
            Some(input("z")),
            &config,
        );
        let reference = golden.reference(&format!("out.step.eta{case}"));
        reference.assert_close_tensor(&case, found, TOLERANCE_DDIM_STEP);
    }
}
