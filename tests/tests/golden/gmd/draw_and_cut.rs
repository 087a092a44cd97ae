//! Samples at the full length, cut to a clip's length. The tolerances are the reference data's own.

use std::ops::ControlFlow;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    ClipRange, Ddpm, FixedNoise, Guidance, Networks, NoiseKeys, PredictionType, Space as _,
    Steering, Time, TimestepPath, ddpm, steered_prediction,
};
use kinegrad_gmd::GroundObjective;
use kinegrad_motion::goal::{
    Goal, GroundTargets, GuidanceConfig, GuidanceLoss, GuidanceNorm, Trajectory,
};
use kinegrad_motion::humanml::{FeatureLayout, Features, Root};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::bench::{kept_timesteps, noise_of_steps, process, space, whole_model};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd2_draws_at_full_length_are_cut("gmd2/draw_and_cut.safetensors"),
        golden_gmd2_recorded_paths_are_held_behind_their_end("gmd2/draw_and_cut.safetensors"),
        golden_gmd2_only_the_first_frames_guide("gmd2/draw_and_cut.safetensors"),
    ]
}

/// A sample of `frames` frames by the model padded to `padded`, with the first frames of the noise.
fn draw(golden: &Golden, frames: usize, padded: usize) -> Tensor<3> {
    let device = Device::flex();
    let model = whole_model(golden, "model.", padded, &device);
    let diffusion = process(PredictionType::Sample);
    let first = |x: Tensor<3>| x.narrow(2, 0, frames);
    let noise = noise_of_steps(golden, "in.noise", &device);
    let given = FixedNoise {
        sampling: noise.into_iter().map(first).collect(),
        imputation: Vec::new(),
    };
    let start: Tensor<3> = first(golden.get("in.x_T").flat().tensor(&device));
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    let networks = Networks {
        tracked: &model,
        plain: &model,
    };
    let path = kept_timesteps(golden)
        .into_iter()
        .map(|t| vec![t; start.dims()[0]]);
    let path = TimestepPath::to_clean(path.collect());
    let mut predict = |x: Tensor<3>, time: &[Time]| {
        let free = Steering::default();
        let clip = ClipRange::None;
        steered_prediction(
            &diffusion,
            &networks,
            x,
            time,
            &text,
            1.0.into(),
            &clip,
            free,
        )
    };
    let go_on = &mut |_, _, _: &_| ControlFlow::Continue(());
    ddpm(
        &diffusion,
        &mut predict,
        start,
        &path,
        &Ddpm::default(),
        NoiseKeys::Fixed(&given),
        go_on,
    )
    .expect("sizes fit")
}

/// The joints of the first `frames` frames of `x`.
fn joints(golden: &Golden, x: &Tensor<3>, frames: usize) -> Vec<f64> {
    let [_, channels, _] = x.dims();
    let space = space(golden, channels, false, &x.device());
    let rows = space
        .to_motion(x.clone())
        .narrow(2, 0, frames)
        .swap_dims(1, 2);
    let rows = rows.try_into_vec_as::<f32>().expect("float32");
    let layout = FeatureLayout::of_channels(channels).expect("the layout of 22 joints");
    let clips = rows.chunks(channels * frames).map(|clip| {
        let features = Features::new(clip.to_vec(), layout, Root::Absolute);
        features.expect("features").joints().to_f32()
    });
    wide(&clips.flatten().collect::<Vec<f32>>())
}

fn golden_gmd2_draws_at_full_length_are_cut(golden: Golden) {
    let full = golden.get("in.x_T").shape[3];
    let drawn = draw(&golden, full, 224);
    golden
        .get("out.full")
        .flat()
        .assert_within("full", drawn.clone(), 3e-4, 0.0);
    let bare = draw(&golden, full, full);
    golden
        .get("out.full_padded_to_32")
        .flat()
        .assert_within("without padding", bare, 3e-4, 0.0);
    let names = golden.names_under("out.direct");
    let lengths = names
        .iter()
        .map(|name| name.parse::<usize>().expect("a length"));
    for frames in lengths.chain([full]) {
        let cut = format!("out.cut{frames}.joints");
        golden.compare(&cut, &joints(&golden, &drawn, frames), 1e-4);
        if frames < full {
            // Something else.
            let direct = draw(&golden, frames, 224);
            let name = format!("out.direct{frames}");
            golden
                .get(&name)
                .flat()
                .assert_within(&name, direct, 3e-4, 0.0);
        }
    }
}

fn golden_gmd2_recorded_paths_are_held_behind_their_end(golden: Golden) {
    let roots = golden.get("in.recorded_root");
    let frames = roots.shape[1];
    let lengths = golden.get("out.recorded.target_mask");
    let (mut imputed, mut targets) = (Vec::new(), Vec::new());
    for (clip, root) in roots.values.chunks(3 * frames).enumerate() {
        let mask = &lengths.values[clip * 2 * frames..][..2 * frames];
        let length = mask
            .iter()
            .step_by(2)
            .filter(|value| **value == 1.0)
            .count();
        let (root, _) = root.as_chunks::<3>();
        let held: Vec<[f64; 2]> = (0..frames)
            .map(|frame| root[frame.min(length - 1)])
            .map(|[x, _, z]| [x, z])
            .collect();
        let [values, _] = GroundTargets::trajectory(&held, 0, frames).in_channels(4, frames);
        imputed.extend(wide(&values[frames..3 * frames]));
        let mut goal = Goal::new(frames);
        goal.trajectory = Some(Trajectory {
            first_frame: 0,
            points: root[..length].iter().map(|&[x, _, z]| [x, z]).collect(),
        });
        let positions = goal.points().positions().to_vec();
        targets.extend(positions.iter().flat_map(|place| match place {
            Some(_) => [1.0; 2],
            None => [0.0; 2],
        }));
    }
    golden.compare("out.recorded.imputed_xz", &imputed, 0.0);
    golden.compare("out.recorded.target_mask", &targets, 0.0);
}

fn golden_gmd2_only_the_first_frames_guide(golden: Golden) {
    let device = Device::flex();
    let target = golden.get("in.guide_target_xz");
    let frames = target.shape[1];
    let goals = target.values.chunks(2 * frames).map(|points| {
        let mut goal = Goal::new(frames);
        goal.trajectory = Some(Trajectory {
            first_frame: 0,
            points: points.as_chunks::<2>().0.to_vec(),
        });
        goal
    });
    let goals: Vec<Goal> = goals.collect();
    let plain = whole_model(&golden, "model.", 224, &device);
    let tracked = whole_model(&golden, "model.", 224, &device.clone().autodiff()).no_grad();
    let networks = Networks {
        tracked: &tracked,
        plain: &plain,
    };
    let start: Tensor<3> = golden.get("in.x_T").flat().tensor(&device);
    let space = space(&golden, start.dims()[1], false, &device);
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    for (name, norm) in [("l1", GuidanceNorm::L1), ("mse", GuidanceNorm::Mse)] {
        let config = GuidanceConfig {
            norm,
            frame_limit: Some(13),
        };
        let objective = GroundObjective {
            space: &space,
            loss: GuidanceLoss::new(&config, &goals, frames).expect("goals"),
        };
        let steering = Steering {
            guidance: Some(Guidance {
                objective: &objective,
                scale: 100.0,
                max_shift: None,
            }),
            imputation: None,
        };
        let prediction = steered_prediction(
            &process(PredictionType::Sample),
            &networks,
            start.clone(),
            &Time::of(&[500; 2]),
            &text,
            1.0.into(),
            &ClipRange::None,
            steering,
        )
        .expect("sizes fit");
        let found = prediction.steered.expect("steered").scaled_gradient;
        let what = format!("out.guide_first13.{name}");
        golden
            .get(&what)
            .flat()
            .assert_within(&what, found.expect("guided"), 1e-5, 0.0);
    }
}
