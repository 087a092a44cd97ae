//! Steps guided by the gradient of a goal.

use burn::tensor::Tensor;
use kinegrad_diffusion::{Guidance, Objective, PredictionType, Steering};
use kinegrad_gmd::GroundObjective;
use kinegrad_motion::goal::{Goal, GuidanceConfig, GuidanceLoss, GuidanceNorm, Keyframe, Obstacle};
use kinegrad_tests::golden::{Golden, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::bench::{Bench, space};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![golden_gmd_guidance("gmd/guidance.safetensors"),]
}

/// The goals of the file, one for each sample, with its obstacles if they are used.
pub fn goals(golden: &Golden, obstacles: bool) -> Vec<Goal> {
    let (mask, target) = (golden.get("in.target_mask"), golden.get("in.target_xz"));
    let [batch, frames] = mask.shape[..] else {
        panic!("a mask for each sample and frame");
    };
    let discs = golden.get("in.obstacles");
    (0..batch)
        .map(|sample| {
            let mut goal = Goal::new(frames);
            goal.keyframes = (0..frames)
                .filter(|frame| mask.values[sample * frames + frame] != 0.0)
                .map(|frame| {
                    let place = 2 * (sample * frames + frame);
                    Keyframe {
                        frame,
                        x: target.values[place],
                        z: target.values[place + 1],
                    }
                })
                .collect();
            if obstacles {
                goal.obstacles = discs
                    .values
                    .chunks(3)
                    .map(|disc| Obstacle::Disc {
                        x: disc[0],
                        z: disc[1],
                        radius: disc[2],
                    })
                    .collect();
            }
            goal
        })
        .collect()
}

fn golden_gmd_guidance(golden: Golden) {
    for (kind, prediction_type) in [
        ("traj", PredictionType::Epsilon),
        ("motion", PredictionType::Sample),
    ] {
        let bench = Bench::new(&golden, &format!("model.{kind}."), prediction_type);
        let x_t = bench.input(&format!("in.{kind}.x_t"));
        let [_, channels, frames] = x_t.dims();
        let space = space(&golden, channels, kind == "motion", &bench.device);
        // The inverse projection has a condition number of some hundreds.
        let (absolute, relative) = match kind {
            "motion" => (1e-4, 1e-3),
            _ => (1e-4, 1e-4),
        };
        let timesteps = golden.get("in.timesteps").indices();
        // Obstacles are stored for the trajectory alone.
        let variants = match kind {
            "traj" => &["l1", "mse", "sdf_l1"][..],
            _ => &["l1", "mse"],
        };
        for &variant in variants {
            let with_obstacles = variant == "sdf_l1";
            let config = GuidanceConfig {
                norm: match variant {
                    "mse" => GuidanceNorm::Mse,
                    _ => GuidanceNorm::L1,
                },
                frame_limit: None,
            };
            let goals = goals(&golden, with_obstacles);
            let loss = GuidanceLoss::new(&config, &goals, frames).expect("goals");
            let goal = GroundObjective {
                space: &space,
                loss,
            };
            for (index, &timestep) in timesteps.iter().enumerate() {
                let steering = Steering {
                    guidance: Some(Guidance {
                        objective: &goal as &dyn Objective,
                        scale: 100.0,
                        max_shift: None,
                    }),
                    imputation: None,
                };
                let none = Steering::default();
                let step = |steering| bench.step(x_t.clone(), timestep, None, None, steering);
                bench
                    .part(&format!("out.{kind}.unguided_mean"), index)
                    .assert_within("unguided mean", step(&none).prev_sample, 1e-4, 1e-4);
                // Guidance acts while t >= 20 alone; the file's obstacles act always.
                let acts = timestep >= 20 || with_obstacles;
                let steering = if acts { &steering } else { &none };
                let led = step(steering);
                let what = |of: &str| format!("{kind} {variant} {of} at {timestep}");
                let scaled_gradient = led.scaled_gradient.unwrap_or_else(|| x_t.zeros_like());
                let part = |of: &str| bench.part(&format!("out.{kind}.{variant}.{of}"), index);
                part("scaled_grad").assert_within(
                    &what("scaled gradient"),
                    scaled_gradient,
                    absolute,
                    relative,
                );
                if with_obstacles {
                    continue;
                }
                if kind == "traj" {
                    part("mean").assert_within(&what("mean"), led.prev_sample, absolute, relative);
                }
                let noise = bench.part(&format!("in.{kind}.noise"), index);
                let noise = Some(noise.tensor(&bench.device));
                let step = bench.step(x_t.clone(), timestep, noise, None, steering);
                part("sample").assert_within(&what("sample"), step.prev_sample, absolute, relative);
            }
        }
        if kind == "traj" {
            unguided(&bench, x_t);
        }
    }
}

/// The inputs of guidance: prediction and variance of each step.
fn unguided(bench: &Bench<'_>, x_t: Tensor<3>) {
    let timesteps = bench.timesteps();
    let variances = &bench.diffusion.schedule.posterior_variance;
    let variances: Vec<f64> = timesteps.iter().map(|&t| variances[t]).collect();
    let golden = bench.golden;
    golden.compare_relative("out.traj.variance", &variances, 1e-6);
    for (index, &timestep) in timesteps.iter().enumerate() {
        let step = bench.step(x_t.clone(), timestep, None, None, &Steering::default());
        let expected = bench.part("out.traj.pred_xstart", index);
        let what = format!("prediction at {timestep}");
        expected.assert_within(&what, step.pred_original_sample, 1e-4, 1e-4);
    }
}
