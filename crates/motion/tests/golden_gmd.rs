//! Emphasis projection and goals against the reference data of Guided Motion Diffusion.
//!
//! The tolerances are the reference data's own.

use kinegrad_golden::{Golden, wide};
use kinegrad_motion::emphasis::{EmphasisProjection, relative_importance};
use kinegrad_motion::goal::{
    Goal, GroundTargets, GuidanceConfig, GuidanceLoss, GuidanceNorm, Keyframe, Obstacle, Phase,
};

/// The rows that the published models emphasise: root rotation, x and z.
const CHANNELS: [usize; 3] = [0, 1, 2];

fn open(name: &str) -> Option<Golden> {
    Golden::open("gmd", &format!("{name}.safetensors"))
}

/// What differs between the files' tolerances.
struct Tolerances {
    projected: f64,
    round_trip: f64,
}

/// Everything that a file says about one projection, under keys that begin with `prefix`.
fn check_projection(golden: &Golden, prefix: &str, scale: f64, tolerances: &Tolerances) {
    let key = |name: &str| format!("{prefix}{name}");
    let draws = golden.get("in.G");
    let dimension = draws.shape[0];
    let draws = draws.f32s();
    let projection = EmphasisProjection::gaussian(&draws, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    golden.compare_relative(&key("P"), &wide(projection.matrix()), 1e-6);
    golden.compare_relative(&key("P_inv"), &wide(projection.inverse()), 1e-3);
    let variances = projection.variance_per_dimension();
    golden.compare_relative(&key("var_per_dim"), &variances, 1e-5);
    let frames = golden.get("in.x").f32s();
    let projected = projection.project(&frames);
    golden.compare(&key("y"), &wide(&projected), tolerances.projected);
    let back = wide(&projection.unproject(&projected));
    golden.compare(&key("x_back"), &back, tolerances.round_trip);
    golden.compare("in.x", &back, tolerances.round_trip);
    // As a published model's matrix.
    let given = golden.get(&key("P")).f32s();
    let given = EmphasisProjection::from_matrix(&given, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    golden.compare_relative(&key("P_inv"), &wide(given.inverse()), 1e-3);
    golden.compare(
        &key("y"),
        &wide(&given.project(&frames)),
        tolerances.projected,
    );
}

#[test]
fn golden_projections_of_12_features_agree_at_every_scale() {
    let Some(golden) = open("projection_d12") else {
        return;
    };
    let tolerances = Tolerances {
        projected: 1e-5,
        round_trip: 1e-4,
    };
    let scales = golden.get("in.c_values").values;
    let dimension = golden.get("in.G").shape[0];
    let importance: Vec<f64> = scales
        .iter()
        .map(|&scale| relative_importance(scale, CHANNELS.len(), dimension))
        .collect();
    golden.compare_relative("out.relative_importance", &importance, 1e-6);
    for &scale in &scales {
        check_projection(&golden, &format!("out.c{scale}."), scale, &tolerances);
    }
}

#[test]
fn golden_projection_of_normalised_motion_goes_there_and_back() {
    let Some(golden) = open("projection_d12") else {
        return;
    };
    // The reference has this at a scale of 10.
    let matrix = golden.get("out.c10.P").f32s();
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let dimension = mean.len();
    let projection = EmphasisProjection::from_matrix(&matrix, dimension, 10.0, &CHANNELS)
        .expect("the reference matrix can be undone");
    let each_channel = |values: &[f64], map: &dyn Fn(f64, usize) -> f64| -> Vec<f64> {
        let places = values.iter().enumerate();
        places
            .map(|(index, &value)| map(value, index % dimension))
            .collect()
    };
    let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect::<Vec<_>>();
    let normalised = each_channel(&golden.get("in.motion").values, &|v, c| {
        (v - mean[c]) / std[c]
    });
    let projected = projection.project(&single(normalised));
    golden.compare("out.motion_to_model", &wide(&projected), 1e-5);
    let back = wide(&projection.unproject(&projected));
    let motion = each_channel(&back, &|v, c| v * std[c] + mean[c]);
    golden.compare("out.model_to_motion", &motion, 1e-4);
    golden.compare("in.motion", &motion, 1e-4);
}

#[test]
fn golden_projection_at_full_width_agrees() {
    let Some(golden) = open("projection_d263") else {
        return;
    };
    let tolerances = Tolerances {
        projected: 5e-5,
        round_trip: 1e-3,
    };
    // The reference's own routine has this scale.
    let scale = 10.0;
    check_projection(&golden, "out.", scale, &tolerances);
    let dimension = golden.get("in.G").shape[0];
    let expected = relative_importance(scale, CHANNELS.len(), dimension);
    golden.compare_relative("out.relative_importance_expected", &[expected], 1e-6);
    let draws = golden.get("in.G").f32s();
    let projection = EmphasisProjection::gaussian(&draws, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    let share = [projection.trajectory_share()];
    golden.compare_relative("out.relative_importance_of_P", &share, 1e-5);
    let own = projection.measure(0);
    eprintln!("as drawn by the reference: {own:?}");
    let orthogonal = EmphasisProjection::orthogonal(&draws, dimension, scale, &CHANNELS)
        .expect("orthogonal matrices can be undone");
    let orthogonal = orthogonal.measure(0);
    eprintln!("orthogonal, from the same draws: {orthogonal:?}");
    assert!(orthogonal.condition_number < own.condition_number);
    assert!(orthogonal.round_trip_max < own.round_trip_max);
}

/// The goals of the file's batch: key frames at the given places of the given tracks.
fn goals(golden: &Golden) -> Vec<Goal> {
    let (tracks, keyframes) = (golden.get("in.root_xyz"), golden.get("in.keyframes"));
    let (frames, per_sample) = (tracks.shape[2], keyframes.shape[1]);
    let keyframes = keyframes.values.chunks(per_sample);
    let samples = tracks.values.chunks(3 * frames).zip(keyframes);
    let goal_of = |(track, places): (&[f64], &[f64])| {
        let mut goal = Goal::new(frames);
        let keyframe = |&place: &f64| {
            let frame = place as usize;
            let (x, z) = (track[frame], track[2 * frames + frame]);
            Keyframe { frame, x, z }
        };
        goal.keyframes = places.iter().map(keyframe).collect();
        goal.validate().expect("the reference's goals are sound");
        goal
    };
    samples.map(goal_of).collect()
}

#[test]
fn golden_key_frames_become_points_and_lines() {
    let Some(golden) = open("keyframes") else {
        return;
    };
    let goals = goals(&golden);
    let four = |key: &str| <[f64; 4]>::try_from(golden.get(key).values).expect("four channels");
    let (mean, std) = (four("in.mean4"), four("in.std4"));
    for (phase, name) in [(Phase::Points, "points"), (Phase::Dense, "p2p")] {
        let targets: Vec<GroundTargets> = goals
            .iter()
            .map(|goal| goal.targets(phase).expect("this phase acts"))
            .collect();
        let all = |of: &dyn Fn(&GroundTargets) -> Vec<f64>| -> Vec<f64> {
            targets.iter().flat_map(of).collect()
        };
        let mask = all(&|targets| {
            let mask = targets.channel_mask().into_iter();
            mask.map(|given| f64::from(u8::from(given))).collect()
        });
        golden.compare(&format!("out.traj_mask_{name}"), &mask, 0.0);
        golden.compare(&format!("out.motion_mask_{name}"), &mask, 0.0);
        let motion = all(&|targets| wide(&targets.motion_space()));
        golden.compare(&format!("out.motion_{name}"), &motion, 1e-5);
        let model = all(&|targets| wide(&targets.model_space(&mean, &std)));
        golden.compare(&format!("out.traj_{name}"), &model, 1e-5);
        if phase == Phase::Dense {
            let ground = all(&|targets| {
                let frames = targets.frames();
                wide(&targets.motion_space()[frames..3 * frames])
            });
            golden.compare("out.traj_p2p_motion_space_xz", &ground, 1e-5);
        }
    }
    // Targets as points in space, the height never given.
    let in_space = |place: &Option<[f64; 2]>| place.map_or([0.0; 3], |[x, z]| [x, 0.0, z]);
    let given = |place: &Option<[f64; 2]>| place.map_or([0.0; 3], |_| [1.0, 0.0, 1.0]);
    let all = |of: &dyn Fn(&Option<[f64; 2]>) -> [f64; 3]| -> Vec<f64> {
        let points = goals.iter().map(Goal::points);
        points
            .flat_map(|points| points.positions().iter().flat_map(of).collect::<Vec<_>>())
            .collect()
    };
    golden.compare("out.target", &all(&in_space), 1e-5);
    golden.compare("out.target_mask", &all(&given), 0.0);
}

#[test]
fn golden_zigzag_is_walked_along_straight_lines() {
    let Some(golden) = open("keyframes") else {
        return;
    };
    let rows = golden.get("in.zigzag").values;
    let (rows, _) = rows.as_chunks::<3>();
    let keyframes: Vec<Keyframe> = rows
        .iter()
        .map(|&[frame, x, z]| Keyframe {
            frame: frame as usize,
            x,
            z,
        })
        .collect();
    let frames = golden.get("out.zigzag_interpolated").shape[0];
    let line = GroundTargets::point_to_point(&keyframes, frames);
    let found: Vec<f64> = line
        .masked()
        .flat_map(|(frame, [x, z])| [frame as f64, x, z])
        .collect();
    golden.compare("out.zigzag_interpolated", &found, 1e-5);
}

/// The reference's denoiser of the trajectory, `s tanh(W x + v t / 1000)`, on one frame of noise,
/// and what the reference makes of it: the clamped prediction of the start.
struct Denoiser {
    weights: Vec<f64>,
    time: Vec<f64>,
    size: f64,
}

impl Denoiser {
    /// The prediction for each channel and its slopes by each channel of `x`.
    fn predict(&self, x: &[f64], t: f64, alpha: f64) -> Vec<(f64, Vec<f64>)> {
        let noise_share = (1.0 / alpha - 1.0).sqrt();
        let rows = self.weights.chunks(x.len()).zip(&self.time).enumerate();
        let channel = |(index, (weights, time)): (usize, (&[f64], &f64))| {
            let dot: f64 = weights.iter().zip(x).map(|(w, x)| w * x).sum();
            let wave = (dot + time * t / 1000.0).tanh();
            let start = x[index] / alpha.sqrt() - noise_share * self.size * wave;
            let slope = |(other, weight): (usize, &f64)| {
                let direct = if other == index {
                    alpha.sqrt().recip()
                } else {
                    0.0
                };
                let slope = direct - noise_share * self.size * (1.0 - wave * wave) * weight;
                // A clamped prediction does not move.
                if start.abs() > 6.0 { 0.0 } else { slope }
            };
            let slopes = weights.iter().enumerate().map(slope).collect();
            (start.clamp(-6.0, 6.0), slopes)
        };
        rows.map(channel).collect()
    }
}

#[test]
fn golden_guidance_of_the_trajectory_agrees() {
    let (Some(golden), Some(schedule)) = (open("guidance"), open("schedule_cosine1000")) else {
        return;
    };
    let alphas = schedule.get("out.alphas_cumprod").values;
    let denoiser = Denoiser {
        weights: golden.get("model.traj.W").values,
        time: golden.get("model.traj.v").values,
        size: golden.get("model.traj.s").values[0],
    };
    let x_t = golden.get("in.traj.x_t");
    let (batch, channels, frames) = (x_t.shape[0], x_t.shape[1], x_t.shape[3]);
    let x_t = x_t.values;
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let (targets, mask) = (
        golden.get("in.target_xz").values,
        golden.get("in.target_mask").values,
    );
    let goal_of = |sample: usize| {
        let mut goal = Goal::new(frames);
        let places = (0..frames).filter(|frame| mask[sample * frames + frame] > 0.0);
        let keyframe = |frame: usize| {
            let place = 2 * (sample * frames + frame);
            let (x, z) = (targets[place], targets[place + 1]);
            Keyframe { frame, x, z }
        };
        goal.keyframes = places.map(keyframe).collect();
        goal
    };
    let obstacles = golden.get("in.obstacles").values;
    let (obstacles, _) = obstacles.as_chunks::<3>();
    let free: Vec<Goal> = (0..batch).map(goal_of).collect();
    let mut obstructed = free.clone();
    for goal in &mut obstructed {
        let disc = |&[x, z, radius]: &[f64; 3]| Obstacle::Disc { x, z, radius };
        goal.obstacles = obstacles.iter().map(disc).collect();
    }
    // Strength and end of the published guidance; obstacles are stored for every timestep.
    let (strength, until) = (100.0, 20.0);
    let variants = [
        ("l1", GuidanceNorm::L1, &free, until),
        ("mse", GuidanceNorm::Mse, &free, until),
        ("sdf_l1", GuidanceNorm::L1, &obstructed, 0.0),
    ];
    for (name, norm, goals, until) in variants {
        let config = GuidanceConfig {
            norm,
            frame_limit: Some(120),
        };
        let loss = GuidanceLoss::new(&config, goals, frames).expect("sound goals");
        let mut found = Vec::new();
        for t in golden.get("in.timesteps").values {
            let predictions: Vec<_> = (0..batch * frames)
                .map(|place| {
                    let (sample, frame) = (place / frames, place % frames);
                    let of_channel = |c| x_t[(sample * channels + c) * frames + frame];
                    let x: Vec<f64> = (0..channels).map(of_channel).collect();
                    denoiser.predict(&x, t, alphas[t as usize])
                })
                .collect();
            let metres = |prediction: &Vec<(f64, Vec<f64>)>| {
                [1, 2].map(|channel| prediction[channel].0 * std[channel] + mean[channel])
            };
            let ground: Vec<f64> = predictions.iter().flat_map(metres).collect();
            let (_, gradient) = loss.evaluate(&ground);
            let scaled = |sample: usize, channel: usize, frame: usize| {
                let place = sample * frames + frame;
                let through = |axis: usize| {
                    let slope = predictions[place][axis + 1].1[channel];
                    gradient[2 * place + axis] * std[axis + 1] * slope
                };
                let acts = if t >= until { strength } else { 0.0 };
                -acts * (through(0) + through(1))
            };
            for sample in 0..batch {
                for channel in 0..channels {
                    found.extend((0..frames).map(|frame| scaled(sample, channel, frame)));
                }
            }
        }
        let key = format!("out.traj.{name}.scaled_grad");
        let reference = golden.get(&key).values;
        let errors = found.iter().zip(&reference);
        let error = errors.map(|(a, b)| (a - b).abs() / (1.0 + b.abs()));
        golden.bound(&key, error.fold(0.0, f64::max), 1e-4);
    }
}
