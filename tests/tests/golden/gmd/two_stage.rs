//! Complete sampling in two stages: the trajectory model's path, the transfer, and the motion along
//! it. The tolerances are the reference data's own.

use std::ops::ControlFlow;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    ClipRange, Ddpm, FixedNoise, Networks, NoiseKeys, PredictionType, Space as _, Time,
    TimestepPath, ddpm, steered_prediction,
};
use kinegrad_gmd::network::TextDenoiser;
use kinegrad_gmd::{Padding, StageModel, StageSteering, SteeringConfig};
use kinegrad_motion::goal::{
    Goal, GroundTargets, GuidanceConfig, GuidanceNorm, GuidanceSchedule, Keyframe, Obstacle, Phase,
};
use kinegrad_motion::humanml::{FeatureLayout, Features, Root};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_train::clips::FeatureSpace;

use super::bench::{kept_timesteps, noise_of_steps, process, space, whole_model};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd2_goals_as_lines_and_points("gmd2/two_stage.safetensors"),
        golden_gmd2_respaced_schedule("gmd2/two_stage.safetensors"),
        golden_gmd2_two_stage_demonstration("gmd2/two_stage.safetensors"),
        golden_gmd2_two_stage_obstacles("gmd2/two_stage.safetensors"),
        golden_gmd2_two_stage_evaluation("gmd2/two_stage.safetensors"),
        golden_gmd2_two_stage_guided_text("gmd2/two_stage.safetensors"),
    ]
}

/// The settings of a variant of the file.
struct Variant {
    name: &'static str,
    /// Source of the keyframes: `demo` or `eval`.
    keyframes: &'static str,
    norm: GuidanceNorm,
    obstacles: bool,
    /// Guidance of any stage, and of the second stage.
    guided: [bool; 2],
    text: bool,
    motion_until: usize,
}

/// The demonstration program's variants; `d` has text guidance.
fn demonstration(name: &'static str, norm: GuidanceNorm, obstacles: bool, text: bool) -> Variant {
    Variant {
        name,
        keyframes: "demo",
        norm,
        obstacles,
        guided: [true; 2],
        text,
        motion_until: 1,
    }
}

/// The evaluation program's variants.
fn evaluation(name: &'static str, guided: bool, text: bool) -> Variant {
    Variant {
        name,
        keyframes: "eval",
        norm: GuidanceNorm::L1,
        obstacles: false,
        guided: [guided, false],
        text,
        motion_until: 20,
    }
}

fn golden_gmd2_two_stage_demonstration(golden: Golden) {
    compare(
        &golden,
        &demonstration("a", GuidanceNorm::Mse, false, false),
    );
    compare(
        &golden,
        &demonstration("a_l1", GuidanceNorm::L1, false, false),
    );
}

fn golden_gmd2_two_stage_obstacles(golden: Golden) {
    compare(&golden, &demonstration("b", GuidanceNorm::Mse, true, false));
    compare(
        &golden,
        &demonstration("b_l1", GuidanceNorm::L1, true, false),
    );
}

fn golden_gmd2_two_stage_evaluation(golden: Golden) {
    compare(&golden, &evaluation("c", true, false));
    compare(&golden, &evaluation("c_plain", false, false));
}

fn golden_gmd2_two_stage_guided_text(golden: Golden) {
    compare(&golden, &demonstration("d", GuidanceNorm::Mse, false, true));
    compare(&golden, &evaluation("d_eval", true, true));
}

/// The goals of `demo` or `eval`. Keyframes in the same frame are equal; the first is used.
fn goals(golden: &Golden, program: &str, obstacles: bool) -> Vec<Goal> {
    let frames = golden.get("in.motion.x_T").shape[3];
    let places = golden.get(&format!("in.{program}.keyframes"));
    let positions = golden.get(&format!("in.{program}.key_xz"));
    let discs = golden.get("in.demo.obstacles");
    let count = places.shape[1];
    let samples = places.indices();
    let samples = samples
        .chunks(count)
        .zip(positions.values.chunks(2 * count));
    samples
        .map(|(places, positions)| {
            let mut goal = Goal::new(frames);
            let (positions, _) = positions.as_chunks::<2>();
            goal.keyframes = places
                .iter()
                .zip(positions)
                .map(|(&frame, &[x, z])| Keyframe { frame, x, z })
                .collect();
            goal.keyframes.dedup_by_key(|keyframe| keyframe.frame);
            if obstacles {
                let (discs, _) = discs.values.as_chunks::<3>();
                let disc = |&[x, z, radius]: &[f64; 3]| Obstacle::Disc { x, z, radius };
                goal.obstacles = discs.iter().map(disc).collect();
            }
            goal.validate().expect("the reference's goals are sound");
            goal
        })
        .collect()
}

fn golden_gmd2_goals_as_lines_and_points(golden: Golden) {
    for program in ["demo", "eval"] {
        for (phase, name) in [(Phase::Points, "points"), (Phase::Dense, "p2p")] {
            let goals = goals(&golden, program, false);
            let targets = goals.iter().map(|goal| goal.targets(phase).expect("acts"));
            let (values, masks): (Vec<_>, Vec<_>) = targets
                .map(|targets: GroundTargets| targets.in_channels(4, targets.frames()).into())
                .unzip();
            let mask = wide(&masks.concat());
            golden.compare(&format!("out.{program}.traj_mask_{name}"), &mask, 0.0);
            let frames = goals[0].frames;
            let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
            // Values where the mask is 0 have no meaning.
            let place = format!("out.{program}.traj_{name}");
            let reference = golden.get(&place).values;
            let values = wide(&values.concat()).into_iter().zip(&mask).enumerate();
            let (found, expected): (Vec<f64>, Vec<f64>) = values
                .filter(|(_, (_, mask))| **mask == 1.0)
                .map(|(at, (value, _))| {
                    let channel = at / frames % 4;
                    ((value - mean[channel]) / std[channel], reference[at])
                })
                .unzip();
            golden.compare_lists(&place, &found, &expected, 3e-6);
        }
    }
}

fn golden_gmd2_respaced_schedule(golden: Golden) {
    let diffusion = process(PredictionType::Sample);
    let mut kept = kept_timesteps(&golden);
    kept.reverse();
    let abar = &diffusion.schedule.alphas_cumprod;
    let products: Vec<f64> = kept.iter().map(|&t| abar[t]).collect();
    golden.compare("out.schedule.alphas_cumprod", &products, 1e-12);
    let map: Vec<f64> = kept.iter().map(|&t| t as f64).collect();
    golden.compare_exactly("out.schedule.timestep_map", &map);
}

/// One stage of sampling: all states, noisiest first, and the predicted clean motions with the
/// known values in them.
#[expect(
    clippy::too_many_arguments,
    reason = "each is another thing, named at the call"
)]
fn draw(
    golden: &Golden,
    stage: &str,
    [plain, tracked]: [&TextDenoiser; 2],
    prediction_type: PredictionType,
    clip: &ClipRange,
    steering: &StageSteering<'_>,
    guidance_scale: f64,
    device: &Device,
) -> [Vec<Tensor<3>>; 2] {
    let diffusion = process(prediction_type);
    let text = golden
        .tensor::<2>("in.text_features", device)
        .unsqueeze_dim(2);
    let start: Tensor<3> = golden.get(&format!("in.{stage}.x_T")).flat().tensor(device);
    let given = FixedNoise {
        sampling: noise_of_steps(golden, &format!("in.{stage}.noise"), device),
        imputation: match stage {
            "traj" => noise_of_steps(golden, "in.traj.noise_q", device),
            // A model of clean motion needs none, but the sampler requires it.
            _ => noise_of_steps(golden, &format!("in.{stage}.noise"), device),
        },
    };
    let batch = start.dims()[0];
    let path = kept_timesteps(golden).into_iter().map(|t| vec![t; batch]);
    let path = TimestepPath::to_clean(path.collect());
    let networks = Networks { tracked, plain };
    let mut predictions = Vec::new();
    let mut predict = |x: Tensor<3>, time: &[Time]| {
        let steering = steering.at(time[0].timestep());
        let known = steering.imputation.clone();
        let prediction = steered_prediction(
            &diffusion,
            &networks,
            x,
            time,
            &text,
            guidance_scale.into(),
            clip,
            steering,
        )?;
        let x_start = prediction.x_start.clone();
        predictions.push(known.map_or(x_start.clone(), |known| known.put_into(x_start)));
        Ok(prediction)
    };
    let mut samples = Vec::new();
    let keys = NoiseKeys::Fixed(&given);
    ddpm(
        &diffusion,
        &mut predict,
        start,
        &path,
        &Ddpm::default(),
        keys,
        &mut |_, _, x| {
            samples.push(x.clone());
            ControlFlow::Continue(())
        },
    )
    .expect("sizes fit");
    [samples, predictions]
}

fn compare(golden: &Golden, variant: &Variant) {
    let device = Device::flex();
    let [trajectory, motion] = ["traj", "motion"].map(|stage| {
        let models = |device: &Device| whole_model(golden, &format!("model.{stage}."), 224, device);
        [
            models(&device),
            models(&device.clone().autodiff()).no_grad(),
        ]
    });
    let spaces = [
        space(golden, 4, false, &device),
        space(golden, golden.get("in.mean").shape[0], true, &device),
    ];
    let name = variant.name;
    let config = SteeringConfig {
        padding: Padding::Zeros,
        scale: if variant.guided[0] {
            golden.get("in.scale").scalar()
        } else {
            0.0
        },
        imputation: true,
        detours: false,
        second_stage_guidance: variant.guided[1],
        first_stage_steps: None,
        first_stage_guidance_scale: None,
        path_guidance_scale: 1.0,
        max_shift: 1e6,
        attempts: 1,
        guidance: GuidanceConfig {
            norm: variant.norm,
            frame_limit: None,
        },
        schedule: GuidanceSchedule {
            motion_until: Some(variant.motion_until),
            ..GuidanceSchedule::default()
        },
    };
    let goals = goals(golden, variant.keyframes, variant.obstacles);
    let scale = if variant.text {
        golden.get("in.cfg_scale").scalar()
    } else {
        1.0
    };
    let out = |what: &str| golden.get(&format!("out.{name}.{what}"));
    let frames = goals[0].frames;
    let model = |of_motion: bool| StageModel {
        space: &spaces[usize::from(of_motion)],
        channels: if of_motion { 263 } else { 4 },
        of_motion,
        frames,
        device: &device,
    };

    let steering = StageSteering::of_goals(&config, &goals, model(false)).expect("goals");
    let [steps, predictions] = draw(
        golden,
        "traj",
        [&trajectory[0], &trajectory[1]],
        PredictionType::Epsilon,
        &ClipRange::Symmetric(6.0),
        &steering,
        scale,
        &device,
    );
    for (index, sample) in steps.iter().enumerate() {
        let expected = out("traj_steps").part(index).flat();
        expected.assert_within(
            &format!("{name} trajectory, step {index}"),
            sample.clone(),
            3e-4,
            0.0,
        );
    }
    for (index, x_start) in predictions.into_iter().enumerate() {
        let expected = out("traj_x0").part(index).flat();
        expected.assert_within(
            &format!("{name} prediction, step {index}"),
            x_start,
            7e-4,
            0.0,
        );
    }
    let sample = steps.last().expect("steps").clone();
    out("traj_sample")
        .flat()
        .assert_within("trajectory", sample.clone(), 3e-4, 0.0);
    let in_metres = spaces[0].to_motion(sample.clone());
    out("traj_motion_space").assert_within("path", in_metres.swap_dims(1, 2), 2e-4, 0.0);

    let ground = spaces[0].ground(sample).swap_dims(1, 2);
    let ground = wide(&ground.try_into_vec_as::<f32>().expect("float32"));
    let paths = ground
        .chunks(2 * frames)
        .map(|path| path.as_chunks::<2>().0.to_vec());
    let paths: Vec<Vec<[f64; 2]>> = paths.collect();
    let steering = StageSteering::along(&config, &goals, &paths, model(true)).expect("paths");
    let [steps, _] = draw(
        golden,
        "motion",
        [&motion[0], &motion[1]],
        PredictionType::Sample,
        &ClipRange::None,
        &steering,
        scale,
        &device,
    );
    let space: &FeatureSpace = &spaces[1];
    let features = |x: &Tensor<3>| space.to_motion(x.clone()).swap_dims(1, 2);
    for (index, sample) in steps.iter().enumerate() {
        let expected = out("motion_steps_root").part(index);
        let root = features(sample).narrow(2, 0, 4);
        expected.assert_within(&format!("{name} root, step {index}"), root, 3e-3, 0.0);
    }
    let sample = steps.last().expect("steps");
    out("motion_sample")
        .flat()
        .assert_within("motion", sample.clone(), 8e-3, 0.0);
    out("features").assert_within("features", features(sample), 2e-2, 0.0);
    let values = features(sample).try_into_vec_as::<f32>().expect("float32");
    let layout = FeatureLayout::of_channels(263).expect("the layout of 22 joints");
    let clips: Vec<Features> = values
        .chunks(263 * frames)
        .map(|clip| Features::new(clip.to_vec(), layout, Root::Absolute).expect("features"))
        .collect();
    let root = clips.iter().flat_map(Features::root_positions).flatten();
    golden.compare(
        &format!("out.{name}.root_path"),
        &root.collect::<Vec<f64>>(),
        2e-3,
    );
    if golden.has(&format!("out.{name}.joints")) {
        let joints: Vec<f32> = clips
            .iter()
            .flat_map(|clip| clip.joints().to_f32())
            .collect();
        golden.compare(&format!("out.{name}.joints"), &wide(&joints), 5e-3);
    }
    if golden.has(&format!("out.{name}.key_error")) {
        let places = golden
            .get(&format!("in.{}.keyframes", variant.keyframes))
            .indices();
        let targets = golden
            .get(&format!("in.{}.key_xz", variant.keyframes))
            .values;
        let per_clip = places.len() / clips.len();
        let (targets, _) = targets.as_chunks::<2>();
        let errors = places
            .iter()
            .zip(targets)
            .enumerate()
            .map(|(at, (&frame, [x, z]))| {
                let [rx, _, rz] = clips[at / per_clip].root_positions()[frame];
                (rx - x).hypot(rz - z)
            });
        let errors: Vec<f64> = errors.collect();
        golden.compare(&format!("out.{name}.key_error"), &errors, 4e-4);
    }
}
