//! The metrics of the published evaluation. The tolerances are the reference data's own.

use kinegrad_motion::goal::{Goal, Keyframe};
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::metrics::text_motion::{multimodal_distance, r_precision};
use kinegrad_motion::metrics::{
    FeatureMoments, GoalReport, GoalSample, frechet_distance, keyframe_distances,
    mean_pair_distance, replication_interval, skating_ratio, skating_steps, trajectory_diversity,
};
use kinegrad_tests::golden::{Golden, Reference};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// The toes, and frames a second.
const FEET: [usize; 2] = [10, 11];
const FPS: f64 = 20.0;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd2_foot_skating("gmd2/metrics.safetensors"),
        golden_gmd2_keyframe_errors("gmd2/metrics.safetensors"),
        golden_gmd2_trajectory_diversity("gmd2/metrics.safetensors"),
        golden_gmd2_embeddings("gmd2/metrics.safetensors"),
    ]
}

/// The bodies of a tensor `[clips, frames, joints, 3]`.
fn bodies(golden: &Golden, name: &str) -> Vec<Joints> {
    let tensor = golden.get(name);
    let [_, frames, joints, _] = tensor.shape[..] else {
        panic!("{name}: {:?}", tensor.shape);
    };
    let clips = tensor.values.chunks(frames * joints * 3);
    clips
        .map(|clip| Joints::new(clip.as_chunks::<3>().0.to_vec(), joints).expect("positions"))
        .collect()
}

fn golden_gmd2_foot_skating(golden: Golden) {
    for (joints, ratio, velocity) in [
        ("in.joints", "out.skate_ratio", "out.skate_velocity"),
        (
            "in.short_joints",
            "out.short_skate_ratio",
            "out.short_skate_velocity",
        ),
    ] {
        let bodies = bodies(&golden, joints);
        let ratios = bodies
            .iter()
            .map(|joints| skating_ratio(joints, FPS, &FEET).expect("steps"));
        golden.compare(ratio, &ratios.collect::<Vec<_>>(), 2e-6);
        let velocities = bodies.iter().flat_map(|joints| {
            FEET.into_iter()
                .flat_map(|foot| skating_steps(joints, FPS, foot))
        });
        let velocities = velocities.map(|step| f64::from(u8::from(step.contact)) * step.mean_speed);
        golden.compare(velocity, &velocities.collect::<Vec<_>>(), 2e-6);
    }
    let all = golden.get("in.skate_ratio").values;
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    golden.compare("out.gen.skating", &[mean], 2e-6);
}

fn golden_gmd2_keyframe_errors(golden: Golden) {
    let bodies = bodies(&golden, "in.joints");
    let places = golden.get("in.key_frames");
    let per_clip = places.shape[1];
    let targets = golden.get("in.target_root");
    let frames = targets.shape[1];
    let places = places.indices();
    let (targets, _) = targets.values.as_chunks::<3>();
    let goals = places.chunks(per_clip).zip(targets.chunks(frames));
    let goals = goals.map(|(places, root)| {
        let mut goal = Goal::new(frames);
        goal.keyframes = places
            .iter()
            .map(|&frame| Keyframe {
                frame,
                x: root[frame][0],
                z: root[frame][2],
            })
            .collect();
        goal.keyframes.dedup_by_key(|keyframe| keyframe.frame);
        goal
    });
    let goals: Vec<Goal> = goals.collect();
    let ground = |joints: &Joints| joints.track(0).iter().map(|&[x, _, z]| [x, z]).collect();
    let grounds: Vec<Vec<[f64; 2]>> = bodies.iter().map(ground).collect();
    // A keyframe that is named twice is in the file twice.
    let expected = golden.get("out.key_error");
    let mut errors = Vec::new();
    for ((goal, ground), places) in goals.iter().zip(&grounds).zip(places.chunks(per_clip)) {
        let distances = keyframe_distances(goal, ground);
        let of = |place: &usize| goal.keyframes.iter().position(|k| k.frame == *place);
        errors.extend(
            places
                .iter()
                .map(|place| distances[of(place).expect("a keyframe")]),
        );
    }
    golden.compare("out.key_error", &errors, 2e-6);

    // The shares count them twice too, so the clips without repetition are measured by the report.
    let strict = golden.get("out.errors_strict").values;
    let samples = goals.iter().zip(&grounds).map(|(goal, ground)| GoalSample {
        goal,
        ground,
        joints: None,
    });
    let report = GoalReport::compute(&samples.collect::<Vec<_>>(), FPS, &FEET);
    for (found, expected) in [
        (report.trajectory_error_20cm, strict[0]),
        (report.trajectory_error_50cm, strict[1]),
    ] {
        golden.bound(
            "trajectory error",
            (found.expect("some") - expected).abs(),
            2e-6,
        );
    }
    let shares = [0.2, 0.5].map(|most| {
        let missed = expected
            .values
            .iter()
            .filter(|error| **error > most)
            .count();
        missed as f64 / expected.values.len() as f64
    });
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    golden.compare_lists(
        "location errors",
        &[shares[0], shares[1], mean],
        &strict[2..],
        2e-6,
    );
}

fn golden_gmd2_trajectory_diversity(golden: Golden) {
    for (paths, lengths, expected) in [
        (
            "in.trajectories",
            "in.trajectory_lengths",
            "out.trajectory_diversity",
        ),
        (
            "in.mm_trajectories",
            "in.mm_lengths",
            "out.gen.mm_trajectory_diversity",
        ),
    ] {
        let (tensor, lengths) = (golden.get(paths), golden.get(lengths).indices());
        let [_, repetitions, frames, _] = tensor.shape[..] else {
            panic!("{paths}: {:?}", tensor.shape);
        };
        let conditions = tensor.values.chunks(repetitions * frames * 2).zip(lengths);
        let conditions = conditions.map(|(condition, length)| {
            let paths = condition.chunks(frames * 2);
            paths
                .map(|path| path[..2 * length].as_chunks::<2>().0.to_vec())
                .collect()
        });
        let conditions: Vec<Vec<Vec<[f64; 2]>>> = conditions.collect();
        let found = trajectory_diversity(&conditions).expect("paths");
        golden.compare(expected, &[found], 1e-6);
    }
}

/// The rows of a tensor, whatever its leading axes.
fn rows(tensor: &Reference) -> Vec<Vec<f64>> {
    let width = *tensor.shape.last().expect("an axis");
    tensor.values.chunks(width).map(<[f64]>::to_vec).collect()
}

fn golden_gmd2_embeddings(golden: Golden) {
    let of = |name: &str| rows(&golden.get(name));
    let texts = of("in.text_embeddings");
    let (real, drawn) = (
        of("in.gt_motion_embeddings"),
        of("in.gen_motion_embeddings"),
    );
    for (side, motions) in [("gt", &real), ("gen", &drawn)] {
        let precision = r_precision(&texts, motions).expect("whole pools");
        golden.compare(&format!("out.{side}.r_precision"), &precision, 5e-6);
        let score = multimodal_distance(&texts, motions).expect("some");
        golden.compare(&format!("out.{side}.matching_score"), &[score], 5e-6);
        let moments = [motions, &real].map(|of| FeatureMoments::compute(of).expect("finite"));
        let fid = frechet_distance(&moments[0], &moments[1]);
        golden.compare(&format!("out.{side}.fid"), &[fid], 5e-6);
    }
    let few =
        ["in.few_gen", "in.few_gt"].map(|name| FeatureMoments::compute(&of(name)).expect("some"));
    golden.compare("out.few.fid", &[frechet_distance(&few[0], &few[1])], 2e-5);
    let places = |name: &str| golden.get(name).indices();
    let diversity = mean_pair_distance(
        &[drawn],
        &places("in.diversity_first"),
        &places("in.diversity_second"),
    );
    golden.compare("out.gen.diversity", &[diversity.expect("pairs")], 5e-6);
    let embeddings = golden.get("in.mm_embeddings");
    let repetitions = embeddings.shape[1];
    let texts: Vec<Vec<Vec<f64>>> = rows(&embeddings)
        .chunks(repetitions)
        .map(<[_]>::to_vec)
        .collect();
    let found = mean_pair_distance(&texts, &places("in.mm_first"), &places("in.mm_second"));
    let replications = golden.get("in.replications").values;
    let interval = replication_interval(&replications);
    golden.compare("out.replication_interval", &[interval], 5e-6);
    golden.compare("out.gen.multimodality", &[found.expect("pairs")], 5e-6);
}
