//! Keyframes as points and as lines. The tolerances are the reference data's own.

use kinegrad_motion::goal::{Goal, GroundTargets, Keyframe, Phase};
use kinegrad_tests::golden::{Golden, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_key_frames_become_points_and_lines("gmd/keyframes.safetensors"),
        golden_zigzag_is_walked_along_straight_lines("gmd/keyframes.safetensors"),
    ]
}

/// The goals of the file's batch: keyframes at the given places of the given tracks.
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

fn golden_key_frames_become_points_and_lines(golden: Golden) {
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
        let placed = |targets: &GroundTargets| targets.in_channels(4, targets.frames());
        let mask = all(&|targets| wide(&placed(targets)[1]));
        golden.compare(&format!("out.traj_mask_{name}"), &mask, 0.0);
        golden.compare(&format!("out.motion_mask_{name}"), &mask, 0.0);
        let motion = all(&|targets| wide(&placed(targets)[0]));
        golden.compare(&format!("out.motion_{name}"), &motion, 1e-5);
        let model = all(&|targets| {
            let motion = wide(&placed(targets)[0]).into_iter().enumerate();
            let channel = |place: usize| place / targets.frames();
            motion
                .map(|(place, value)| (value - mean[channel(place)]) / std[channel(place)])
                .collect()
        });
        golden.compare(&format!("out.traj_{name}"), &model, 1e-5);
        if phase == Phase::Dense {
            let ground = all(&|targets| {
                let frames = targets.frames();
                wide(&placed(targets)[0][frames..3 * frames])
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

fn golden_zigzag_is_walked_along_straight_lines(golden: Golden) {
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
