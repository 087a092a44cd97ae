//! Steps with imputed values, with and without guidance.

use burn::tensor::Tensor;
use kinegrad_diffusion::{Guidance, Imputation, PredictionType, Space, Steering};
use kinegrad_gmd::GroundObjective;
use kinegrad_motion::goal::{Goal, GuidanceConfig, GuidanceLoss, Keyframe};
use kinegrad_tests::golden::{Golden, Reference, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_train::clips::FeatureSpace;

use super::bench::{Bench, space};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd_imputation_of_motion("gmd/imputation.safetensors"),
        golden_gmd_imputation_of_trajectories("gmd/imputation.safetensors"),
        golden_gmd_guided_imputation("gmd/guided_imputation.safetensors"),
    ]
}

fn imputation<'a>(
    bench: &Bench<'_>,
    space: &'a FeatureSpace,
    target: Tensor<3>,
    mask: &str,
) -> Imputation<'a> {
    Imputation {
        space,
        target,
        mask: bench.input(mask),
    }
}

fn golden_gmd_imputation_of_motion(golden: Golden) {
    for variant in ["plain", "proj"] {
        let bench = Bench::new(&golden, "model.motion.", PredictionType::Sample);
        let x_t = bench.input("in.motion.x_t");
        let channels = x_t.dims()[1];
        let space = space(&golden, channels, variant == "proj", &bench.device);
        let target = bench.input("in.motion.target");
        for (index, &timestep) in bench.timesteps().iter().enumerate() {
            let known = || imputation(&bench, &space, target.clone(), "in.motion.mask");
            let steering = Steering {
                guidance: None,
                imputation: (timestep >= 20).then(known),
            };
            let at = |name: &str| bench.part(&format!("out.motion.{variant}.{name}"), index);
            let noise = bench.part("in.motion.noise", index);
            let noise = Some(noise.tensor(&bench.device));
            let step = bench.step(x_t.clone(), timestep, noise, None, &steering);
            let what = format!("{variant} at {timestep}");
            at("sample").assert_within(&what, step.prev_sample, 1e-4, 0.0);
            let x_start = step.pred_original_sample;
            at("pred_xstart").assert_within("prediction", x_start, 1e-4, 0.0);
            let step = bench.step(x_t.clone(), timestep, None, None, &steering);
            let mean = step.prev_sample;
            at("mean").assert_within("mean", mean, 1e-4, 0.0);
            if timestep == 500 {
                stages(&bench, variant, x_t.clone(), &known());
            }
        }
    }
}

/// The stages of the step at timestep 500: the prediction in metres, in the network's space with
/// the target in it, and the resulting mean.
fn stages(bench: &Bench<'_>, variant: &str, x_t: Tensor<3>, known: &Imputation<'_>) {
    let none = Steering::default();
    let step = bench.step(x_t.clone(), 500, None, None, &none);
    let free = known.mask.clone() * -1.0 + 1.0;
    let motion = known.space.to_motion(step.pred_original_sample);
    let imputed = motion.clone() * free + known.target.clone() * known.mask.clone();
    let x_start = known.space.to_network(imputed);
    let at = vec![500; x_t.dims()[0]];
    let (mean, _) = bench.diffusion.posterior(x_start.clone(), x_t, &at);
    for (stage, found) in [
        ("x0_motion_space", motion),
        ("x0_imputed_model_space", x_start),
        ("mean_imputed", mean),
    ] {
        let name = format!("out.motion.{variant}.t500_{stage}");
        let expected = bench.golden.get(&name).flat();
        expected.assert_within(&name, found, 1e-4, 0.0);
    }
}

fn golden_gmd_imputation_of_trajectories(golden: Golden) {
    let bench = Bench::new(&golden, "model.traj.", PredictionType::Epsilon);
    let x_t = bench.input("in.traj.x_t");
    let space = space(&golden, x_t.dims()[1], false, &bench.device);
    let target = space.to_motion(bench.input("in.traj.target_model_space"));
    for (index, &timestep) in bench.timesteps().iter().enumerate() {
        let mask = match timestep {
            100.. => Some("in.traj.mask_dense"),
            20..100 => Some("in.traj.mask_points"),
            _ => None,
        };
        let steering = Steering {
            guidance: None,
            imputation: mask.map(|mask| imputation(&bench, &space, target.clone(), mask)),
        };
        let part = |name: &str| Some(bench.part(name, index).tensor(&bench.device));
        let (noise, noise_q) = (part("in.traj.noise"), part("in.traj.noise_q"));
        let step = bench.step(x_t.clone(), timestep, noise, noise_q, &steering);
        let (sample, x_start) = (step.prev_sample, step.pred_original_sample);
        bench.part("out.traj.sample", index).assert_within(
            &format!("sample at {timestep}"),
            sample,
            1e-4,
            0.0,
        );
        bench
            .part("out.traj.pred_xstart", index)
            .assert_within("prediction", x_start, 1e-4, 0.0);
    }
}

/// The goals from values in metres `[batch, channels, frames]` where the mask is 1.
fn goals_of(target: &Tensor<3>, mask: &Reference) -> Vec<Goal> {
    let [batch, channels, frames] = target.dims();
    let target = target
        .clone()
        .try_into_vec_as::<f32>()
        .expect("a float32 tensor");
    let [_, masked, _] = mask.shape[..] else {
        panic!("a mask of three axes");
    };
    (0..batch)
        .map(|sample| {
            let mut goal = Goal::new(frames);
            let at = |channel: usize, frame: usize| {
                f64::from(target[(sample * channels + channel) * frames + frame])
            };
            goal.keyframes = (0..frames)
                .filter(|frame| mask.values[(sample * masked + 1) * frames + frame] != 0.0)
                .map(|frame| Keyframe {
                    frame,
                    x: at(1, frame),
                    z: at(2, frame),
                })
                .collect();
            goal
        })
        .collect()
}

fn golden_gmd_guided_imputation(golden: Golden) {
    for (kind, prediction_type) in [
        ("traj", PredictionType::Epsilon),
        ("motion", PredictionType::Sample),
    ] {
        let bench = Bench::new(&golden, &format!("model.{kind}."), prediction_type);
        let x_t = bench.input(&format!("in.{kind}.x_t"));
        let [batch, channels, frames] = x_t.dims();
        let space = space(&golden, channels, kind == "motion", &bench.device);
        let target = match kind {
            "traj" => space.to_motion(bench.input("in.traj.target_model_space")),
            _ => bench.input("in.motion.target"),
        };
        let points = golden.get("in.mask_points").flat();
        let goals = goals_of(&target, &points);
        let loss = GuidanceLoss::new(&GuidanceConfig::default(), &goals, frames).expect("goals");
        let goal = GroundObjective {
            space: &space,
            loss,
        };
        // The masks are of the trajectory's channels; the motion's others are free.
        let mask = |name: &str| {
            let mask = bench.input(name);
            let free = channels - mask.dims()[1];
            match free {
                0 => mask,
                _ => {
                    let zeros = Tensor::zeros([batch, free, frames], &bench.device);
                    Tensor::cat(vec![mask, zeros], 1)
                }
            }
        };
        for (index, &timestep) in bench.timesteps().iter().enumerate() {
            // In this file the motion model has only the keyframes.
            let name = match (kind, timestep) {
                ("traj", 100..) => "in.mask_dense",
                _ => "in.mask_points",
            };
            let steering = match timestep {
                20.. => Steering {
                    guidance: Some(Guidance {
                        objective: &goal,
                        scale: 100.0,
                        max_shift: None,
                    }),
                    imputation: Some(Imputation {
                        space: &space,
                        target: target.clone(),
                        mask: mask(name),
                    }),
                },
                _ => Steering::default(),
            };
            let part = |name: &str| {
                let noise = bench.part(&format!("in.{kind}.{name}"), index);
                noise.tensor(&bench.device)
            };
            let noise = Some(part("noise"));
            // A model of clean motion puts the target into its prediction, without noise.
            let noise_q = (kind == "traj").then(|| part("noise_q"));
            let step = bench.step(x_t.clone(), timestep, noise, noise_q, &steering);
            let sample = step.prev_sample;
            let tolerance = match (kind, timestep) {
                ("motion", 999) => 2e-3,
                _ => 1e-4,
            };
            bench
                .part(&format!("out.{kind}.sample"), index)
                .assert_within(&format!("{kind} at {timestep}"), sample, tolerance, 0.0);
        }
    }
}
