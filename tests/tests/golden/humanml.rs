//! Every tensor of the reference clips of HumanML3D and of the relative and absolute root.
//!
//! The tolerances are the reference data's own.

use std::path::{Path, PathBuf};

use kinegrad_motion::Quaternion;
use kinegrad_motion::humanml::bone_rotations::{facing, inverse_kinematics, to_columns};
use kinegrad_motion::humanml::extract::{canonicalize, in_facing_frame, rescale};
use kinegrad_motion::humanml::{Extraction, Features, Heading, Joints, Root, Skeleton};
use kinegrad_motion::vector::length;
use kinegrad_motion::{JointFeatures, Measured, Statistics};
use kinegrad_tests::golden::{Golden, compared, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::{GoldenTest, Opened};

/// Rotation, ground, height, positions, 6D, velocities, contacts.
const EXTRACTED: [f64; 7] = [1e-6, 1e-5, 1e-5, 1e-5, 5e-5, 1e-5, 0.0];

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_layout_is_the_published_index_list("humanml/index_layout.csv"),
        golden_joints_become_features_walk_straight("humanml/walk_straight.safetensors") => joints_become_features,
        golden_joints_become_features_walk_turn("humanml/walk_turn.safetensors") => joints_become_features,
        golden_joints_become_features_turn_in_place("humanml/turn_in_place.safetensors") => joints_become_features,
        golden_features_become_joints_walk_straight("humanml/walk_straight.safetensors") => features_become_joints,
        golden_features_become_joints_walk_turn("humanml/walk_turn.safetensors") => features_become_joints,
        golden_features_become_joints_turn_in_place("humanml/turn_in_place.safetensors") => features_become_joints,
        golden_statistics_share_deviations_within_groups("humanml/feature_stats.safetensors"),
        golden_root_is_the_same_way_in_both_readings("gmd/rel_abs_root.safetensors"),
    ]
}

/// One reference file.
struct File(Golden);

impl Opened for File {
    fn open(path: &Path) -> Self {
        Self(Golden::open(path))
    }
}

impl File {
    fn joints(&self, key: &str) -> Joints {
        let tensor = self.0.get(key);
        Joints::from_f32(&tensor.f32s(), tensor.shape[1]).expect("finite joints")
    }

    fn features(&self, key: &str, root: Root) -> Features {
        let values = self.0.get(key).f32s();
        Features::new(values, Skeleton::humanml3d().layout(), root).expect("whole frames")
    }

    /// The skeleton with the reference pose of the file.
    fn skeleton(&self) -> Skeleton {
        let rest = self.0.get("in.tgt_rest_joints").vectors();
        let skeleton = Skeleton::humanml3d().with_rest_pose(&rest);
        skeleton.expect("bones have lengths")
    }

    fn compare(&self, key: &str, found: &[f64], tolerance: f64) {
        self.0.compare(key, found, tolerance);
    }

    /// Compares features group by group, each with its own tolerance.
    fn compare_features(&self, key: &str, found: &Features, tolerances: [f64; 7]) {
        let expected = self.features(key, found.root());
        for (group, tolerance) in found.layout().groups().into_iter().zip(tolerances) {
            let part = |features: &Features| -> Vec<f64> {
                let rows = (0..features.frames()).map(|t| &features.frame(t)[group.clone()]);
                rows.flatten().map(|value| f64::from(*value)).collect()
            };
            let what = format!("{key} {group:?}");
            self.bound(&what, &part(found), &part(&expected), tolerance);
        }
    }

    fn bound(&self, what: &str, found: &[f64], expected: &[f64], tolerance: f64) {
        self.0.compare_lists(what, found, expected, tolerance);
    }
}

fn parts(rotations: &[Quaternion]) -> Vec<f64> {
    let each = rotations.iter().flat_map(|q| [q.w, q.x, q.y, q.z]);
    each.collect()
}

fn golden_layout_is_the_published_index_list(path: PathBuf) {
    let text = std::fs::read_to_string(path).expect("golden file is readable");
    let skeleton = Skeleton::humanml3d();
    let lines: Vec<&str> = text.lines().skip(1).collect();
    assert_eq!(lines.len(), skeleton.layout().channels());
    for (index, line) in lines.iter().enumerate() {
        let fields: Vec<&str> = line.trim().split(',').collect();
        assert_eq!(fields[0], index.to_string());
        let name = format!("{}.{}", fields[1], fields[2]);
        assert_eq!(skeleton.channel_name(index), name);
        compared(1);
    }
}

fn joints_become_features(file: File) {
    let skeleton = file.skeleton();
    let source = file.joints("in.joints");
    file.compare("out.tgt_offsets", skeleton.offsets().as_flattened(), 1e-6);
    let uniform = rescale(&skeleton, &source).expect("legs have a length");
    let global = canonicalize(&skeleton, &uniform).expect("joints of the skeleton");
    for (key, joints) in [
        ("out.uniform_joints", &uniform),
        ("out.global_joints", &global),
    ] {
        file.compare(key, joints.as_slice().as_flattened(), 1e-5);
    }
    // The stored raw directions are those before they are brought to length 1.
    let raw: Vec<[f64; 3]> = file
        .0
        .get("out.forward_raw")
        .vectors()
        .into_iter()
        .map(|forward: [f64; 3]| forward.map(|value| value / length(forward)))
        .collect();
    let found = facing(&skeleton, &global, Heading::Raw).expect("joints of the skeleton");
    file.bound(
        "out.forward_raw",
        found.as_flattened(),
        raw.as_flattened(),
        1e-5,
    );
    let found = facing(&skeleton, &global, Heading::Smoothed).expect("joints of the skeleton");
    file.compare("out.forward_smooth", found.as_flattened(), 1e-5);
    let rotations =
        inverse_kinematics(&skeleton, &global, Heading::Smoothed).expect("joints of the skeleton");
    file.compare("out.quats", &parts(&rotations), 5e-5);
    let columns: Vec<[f64; 6]> = rotations.iter().map(|q| to_columns(*q)).collect();
    file.compare("out.cont6d", columns.as_flattened(), 5e-5);
    let local: Vec<[f64; 3]> = (0..global.frames())
        .flat_map(|t| in_facing_frame(global.frame(t), rotations[t * skeleton.joints()]))
        .collect();
    file.compare("out.local_joints", local.as_flattened(), 1e-5);

    let features = Extraction::default()
        .features(&skeleton, &source)
        .expect("a clip of several frames");
    file.compare_features("out.features", &features, EXTRACTED);
}

fn features_become_joints(file: File) {
    let skeleton = file.skeleton();
    let features = file.features("out.features", Root::Relative);
    let half_angles = Root::Relative.half_angles(&features.root_channels());
    file.compare("out.half_angle", &half_angles, 1e-5);
    file.compare("out.root_quat", &parts(&features.root_quaternions()), 1e-5);
    let positions = features.root_positions();
    file.compare("out.root_pos", positions.as_flattened(), 1e-5);
    let joints = features.joints();
    file.compare(
        "out.joints_from_ric",
        joints.as_slice().as_flattened(),
        1e-5,
    );
    let joints = features
        .joints_from_rotations(&skeleton)
        .expect("features of the skeleton");
    file.compare(
        "out.joints_from_rot6d",
        joints.as_slice().as_flattened(),
        2e-5,
    );

    let absolute = features.to_absolute();
    file.compare("out.features_abs", &wide(absolute.as_slice()), 1e-5);
    // The stored joints lack the root's ground position, so they are compared about the root, and
    // the root separately.
    let stored = file.features("out.features_abs", Root::Absolute);
    let positions = stored.root_positions();
    file.compare("out.root_pos", positions.as_flattened(), 1e-5);
    let joints = stored.joints();
    let about_root = |joints: &Joints| -> Vec<f64> {
        let frames = (0..joints.frames()).map(|t| joints.frame(t));
        let moved = frames.flat_map(|frame| in_facing_frame(frame, Quaternion::IDENTITY));
        moved.flatten().collect()
    };
    let expected = about_root(&file.joints("out.joints_from_abs"));
    file.bound("out.joints_from_abs", &about_root(&joints), &expected, 1e-5);

    // The published conversion back: features of those joints, the last row twice.
    let back = Extraction::default()
        .features_in_place(&skeleton, &joints)
        .expect("a clip of several frames");
    let mut values = back.as_slice().to_vec();
    values.extend(back.frame(back.frames() - 1));
    let back = Features::new(values, back.layout(), Root::Relative).expect("whole frames");
    file.compare_features("out.features_rel_from_abs_joints", &back, EXTRACTED);
}

fn golden_statistics_share_deviations_within_groups(file: File) {
    let features = file.features("in.features_concat", Root::Relative);
    let representation = JointFeatures {
        skeleton: Skeleton::humanml3d(),
        root: features.root(),
    };
    let measured = Measured::of(&representation, features.as_slice());
    file.compare("out.mean", &measured.moments().mean, 1e-5);
    file.compare("out.std_per_dim", &measured.moments().std, 1e-5);
    let statistics = measured.statistics(&representation);
    file.compare("out.std_grouped", &statistics.std, 1e-5);

    let expected = file.0.get("out.normalised_first8");
    let (rows, channels) = (expected.shape[0], expected.shape[1]);
    // With the stored mean and deviation, because rounding divided by a small deviation exceeds the
    // tolerance.
    let [mean, std] = ["out.mean", "out.std_grouped"].map(|key| file.0.get(key).values);
    let stored = Statistics::new(mean, std, Some(Root::Relative)).expect("sound statistics");
    let normalised = stored.normalize(features.slice(0..rows).as_slice());
    let row_major = (0..rows).flat_map(|t| (0..channels).map(move |c| c * rows + t));
    let found: Vec<f64> = row_major.map(|i| f64::from(normalised[i])).collect();
    file.compare("out.normalised_first8", &found, 1e-5);
}

fn golden_root_is_the_same_way_in_both_readings(file: File) {
    let shape = file.0.get("in.features_rel").shape;
    let (clips, frames) = (shape[0], shape[1]);
    let read = |key: &str, root: Root| -> Vec<Features> {
        let all = file.features(key, root);
        let clip = |clip: usize| all.slice(clip * frames..(clip + 1) * frames);
        (0..clips).map(clip).collect()
    };
    let (relative, absolute) = (
        read("in.features_rel", Root::Relative),
        read("out.features_abs", Root::Absolute),
    );
    let targets = file.0.get("in.root_target_xz").vectors::<2>();

    for (key, clips, root) in [
        ("out.features_abs", &relative, Root::Absolute),
        ("out.features_rel_back", &absolute, Root::Relative),
    ] {
        let converted = clips
            .iter()
            .map(|clip| wide(clip.with_root(root).as_slice()));
        file.compare(key, &converted.collect::<Vec<_>>().concat(), 1e-5);
    }
    let half_angles = relative
        .iter()
        .map(|clip| clip.root().half_angles(&clip.root_channels()));
    let half_angles = half_angles.collect::<Vec<_>>().concat();
    file.compare("out.rel.half_angle", &half_angles, 1e-5);

    for (name, clips) in [("rel", &relative), ("abs", &absolute)] {
        let (mut positions, mut rotations, mut joints) = (Vec::new(), Vec::new(), Vec::new());
        let (mut loss, mut gradient) = (0.0, Vec::new());
        for (clip, targets) in clips.iter().zip(targets.chunks(frames)) {
            positions.extend(clip.root_positions());
            rotations.extend(clip.root_quaternions());
            joints.extend_from_slice(clip.joints().as_slice());
            let (distance, slope) = clip.root().ground_distance(&clip.root_channels(), targets);
            loss += distance;
            gradient.extend(slope);
        }
        // 40 accumulated steps in single precision.
        file.compare(
            &format!("out.{name}.root_pos"),
            positions.as_flattened(),
            1e-4,
        );
        file.compare(&format!("out.{name}.root_quat"), &parts(&rotations), 1e-5);
        file.compare(&format!("out.{name}.joints"), joints.as_flattened(), 1e-4);
        file.0
            .compare_relative(&format!("out.{name}.root_loss"), &[loss], 1e-4);
        let key = format!("grad.{name}.features4");
        file.0.compare_relative(&key, gradient.as_flattened(), 1e-4);
    }
}
