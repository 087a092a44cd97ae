//! Full-body representations: HumanML3D joint features, and joint positions.

use std::ops::Range;

use super::{Curves, Representation, root_mean_square};
use crate::derivatives::{differences, jerk_of};
use crate::humanml::units::MILLIMETRE;
use crate::humanml::{Extraction, FeatureLayout, Features, Joints, Root, Skeleton};
use crate::moments;
use crate::statistics::CONSTANT;
use crate::vector::{dot, length, minus};
use crate::{BodyMeasure, ChannelMoments, Check, Statistics, Threshold};

/// Allowed mean error of the stated velocities, as a share of the mean step.
const VELOCITY_SHARE: f64 = 0.75;

/// Allowed deviation of a rotation's columns from unit length.
const COLUMN_TOLERANCE: f32 = 0.05;

/// Allowed mean of that deviation. Networks generate columns that are not normalized.
const MEAN_COLUMN_TOLERANCE: f64 = 0.3;

/// Least share of the contacts that agree with the steps of the feet.
const AGREEING_CONTACTS: f64 = 0.5;

/// Joint features of a skeleton, `[frames, 12 J - 1]` for J joints (docs/sources.md, section 3.1).
/// Deviations are averaged within the seven groups of the layout (section 3.5).
#[derive(Clone, Debug)]
pub struct JointFeatures {
    /// The skeleton.
    pub skeleton: Skeleton,
    /// Representation of the root.
    pub root: Root,
}

impl JointFeatures {
    fn layout(&self) -> FeatureLayout {
        self.skeleton.layout()
    }

    fn features(&self, rows: &[f32]) -> Option<Features> {
        let rows = self.layout().in_metres(rows.to_vec());
        Features::new(rows, self.layout(), self.root).ok()
    }

    /// Squared difference between joint 0's displacements and the trajectory for representation
    /// `root`.
    fn mismatch(&self, rows: &[f32], root: Root) -> f64 {
        let Ok(features) = Features::new(rows.to_vec(), self.layout(), root) else {
            return 0.0;
        };
        let trajectory = features.root_positions();
        let displacement = self.layout().velocities().start;
        let steps = trajectory.windows(2).enumerate().map(|(t, pair)| {
            let [x, _, z] = [0, 1, 2].map(|axis| pair[1][axis] - pair[0][axis]);
            let stated = &features.frame(t)[displacement..displacement + 3];
            let stated = f64::from(stated[0]).hypot(f64::from(stated[2]));
            (x.hypot(z) - stated).powi(2)
        });
        steps.sum()
    }
}

/// Names of the groups of [`FeatureLayout::groups`].
const GROUPS: [&str; 7] = [
    "root rotation",
    "root ground velocity",
    "root height",
    "joint positions",
    "joint rotations",
    "joint velocities",
    "foot contacts",
];

impl Representation for JointFeatures {
    fn name(&self) -> String {
        let skeleton = &self.skeleton.description().name;
        format!("joint features of `{skeleton}`, {} root", self.root)
    }

    fn channels(&self) -> usize {
        self.layout().channels()
    }

    fn fps(&self) -> f64 {
        self.skeleton.description().fps
    }

    fn at_rate(&self, fps: f64) -> Option<Box<dyn Representation>> {
        Some(Box::new(Self {
            skeleton: self.skeleton.clone().at_rate(fps),
            root: self.root,
        }))
    }

    fn channel_name(&self, channel: usize) -> String {
        self.layout().channel_name(channel)
    }

    fn groups(&self) -> Vec<(String, Range<usize>)> {
        let names = GROUPS.map(String::from).into_iter();
        names.zip(self.layout().groups()).collect()
    }

    fn statistics(&self, moments: ChannelMoments) -> Statistics {
        let velocity = self.layout().velocities().start;
        let rms_speed = self.fps() * root_mean_square(&moments, velocity..velocity + 3);
        let measured = moments.std.clone();
        let mut statistics = Statistics::standard(moments);
        for group in self.layout().groups() {
            let average = measured[group.clone()].iter().sum::<f64>() / group.len() as f64;
            statistics.std[group].fill(if average < CONSTANT { 1.0 } else { average });
        }
        Statistics {
            root: Some(self.root),
            rms_speed: Some(rms_speed),
            ..statistics
        }
    }

    fn joints(&self, rows: &[f32]) -> Option<Joints> {
        Some(self.features(rows)?.joints())
    }

    fn skeleton(&self) -> Option<&Skeleton> {
        Some(&self.skeleton)
    }

    fn movement(&self, rows: &[f32]) -> Vec<(&'static str, f64)> {
        movement(self, rows)
    }

    fn channel_checks(&self, rows: &[f32]) -> Vec<Check> {
        let Some(features) = self.features(rows) else {
            return Vec::new();
        };
        vec![
            velocities(&features),
            rotations(&features),
            contacts(&features, &self.skeleton),
        ]
    }

    /// Root representations have equal channels; the one that fits joint 0's steps is accepted.
    fn accepts(&self, shape: &[usize], values: &[f32]) -> bool {
        let fits =
            matches!(shape, [_, channels] if *channels == self.channels()) && !values.is_empty();
        let roots = [Root::Relative, Root::Absolute];
        let [relative, absolute] = roots.map(|root| self.mismatch(values, root));
        fits && match self.root {
            Root::Relative => relative <= absolute,
            Root::Absolute => absolute < relative,
        }
    }

    /// The first invalid rotation, which indicates normalized features or another layout.
    fn implausible(&self, rows: &[f32]) -> Option<String> {
        let frames = rows.chunks_exact(self.channels()).enumerate();
        frames.into_iter().find_map(|(t, frame)| {
            let (columns, _) = frame[self.layout().rotations()].as_chunks::<3>();
            let length = |column: &[f32; 3]| column.iter().map(|v| v * v).sum::<f32>().sqrt();
            let odd = |column: &[f32; 3]| (length(column) - 1.0).abs() > COLUMN_TOLERANCE;
            let place = columns.iter().position(odd)?;
            Some(format!(
                "joint rotations are invalid in frame {t}: a column of joint {} has length {:.3}, 1 \
                 expected (are the features normalised already?)",
                1 + place / 2,
                length(&columns[place])
            ))
        })
    }

    fn curves(&self, rows: &[f32]) -> Vec<Curves> {
        let Some(joints) = self.joints(rows) else {
            return Vec::new();
        };
        let mut curves = curves(&joints, Some(&self.skeleton), self.fps());
        let names = ["left ankle", "left foot", "right ankle", "right foot"];
        let (title, contacts, width) = ("foot contacts", self.layout().contacts(), self.channels());
        curves.push(Curves::channels(title, rows, width, contacts, &names));
        curves
    }
}

/// Joint positions, `[frames, J, 3]`, converted to metres by the size of the body.
#[derive(Clone, Debug)]
pub struct JointPositions {
    /// The skeleton.
    pub skeleton: Skeleton,
}

impl Representation for JointPositions {
    fn name(&self) -> String {
        format!("joint positions of `{}`", self.skeleton.description().name)
    }

    fn channels(&self) -> usize {
        3 * self.skeleton.joints()
    }

    /// The number of feature channels, because datasets store these clips as features.
    fn stored_channels(&self) -> usize {
        self.skeleton.layout().channels()
    }

    fn fps(&self) -> f64 {
        self.skeleton.description().fps
    }

    fn at_rate(&self, fps: f64) -> Option<Box<dyn Representation>> {
        Some(Box::new(Self {
            skeleton: self.skeleton.clone().at_rate(fps),
        }))
    }

    fn shape(&self) -> String {
        format!("[T, {}, 3]", self.skeleton.joints())
    }

    fn channel_name(&self, channel: usize) -> String {
        format!("joint_{}.{}", channel / 3, ["x", "y", "z"][channel % 3])
    }

    fn joints(&self, rows: &[f32]) -> Option<Joints> {
        let joints = Joints::from_f32(rows, self.skeleton.joints()).ok()?;
        let unit = unit_of(&joints);
        let places = joints.as_slice().iter();
        let places = places.map(|place| place.map(|value| unit * value));
        Joints::new(places.collect(), joints.joints()).ok()
    }

    fn skeleton(&self) -> Option<&Skeleton> {
        Some(&self.skeleton)
    }

    fn movement(&self, rows: &[f32]) -> Vec<(&'static str, f64)> {
        movement(self, rows)
    }

    fn channel_checks(&self, rows: &[f32]) -> Vec<Check> {
        let joints = Joints::from_f32(rows, self.skeleton.joints());
        joints
            .map(|joints| metres(unit_of(&joints)))
            .into_iter()
            .collect()
    }

    fn accepts(&self, shape: &[usize], _values: &[f32]) -> bool {
        matches!(shape, [frames, joints, 3] if *frames > 0 && *joints == self.skeleton.joints())
    }
}

/// The measures of a body by name.
fn movement<R: Representation>(representation: &R, rows: &[f32]) -> Vec<(&'static str, f64)> {
    let Some(joints) = representation.joints(rows) else {
        return Vec::new();
    };
    let (skeleton, fps) = (representation.skeleton(), representation.fps());
    let of =
        |measure: BodyMeasure| Some((measure.name(), measure.of(&joints, skeleton, fps)?.value));
    BodyMeasure::ALL.into_iter().filter_map(of).collect()
}

/// The stated velocities of the joints against the steps of their positions: the mean error as a
/// share of the mean step. Motion whose frames are in reverse order has an error of about 2.
fn velocities(features: &Features) -> Check {
    let (joints, turns) = (features.joints(), features.root_quaternions());
    let [mut error, mut size] = [0.0; 2];
    for (t, turn) in turns.into_iter().enumerate().take(joints.frames() - 1) {
        let stated = &features.frame(t)[features.layout().velocities()];
        let steps = joints.frame(t + 1).iter().zip(joints.frame(t));
        for ((next, here), stated) in steps.zip(stated.as_chunks::<3>().0) {
            let step = turn.rotate(minus(*next, *here));
            error += length(minus(step, stated.map(f64::from)));
            size += length(step);
        }
    }
    let share = error / size.max(f64::MIN_POSITIVE);
    let message = format!(
        "mean error of the joints' velocities: {:.0} % of them",
        100.0 * share
    );
    let allowed = Threshold::AtMost(VELOCITY_SHARE);
    Check::new("velocity_coherence", share, allowed, message)
}

/// The columns of the rotations have length 1.
fn rotations(features: &Features) -> Check {
    let frames = (0..features.frames()).map(|t| features.frame(t));
    let columns = frames.flat_map(|frame| frame[features.layout().rotations()].as_chunks::<3>().0);
    let deviations = columns.map(|column| (length(column.map(f64::from)) - 1.0).abs());
    let deviations: Vec<f64> = deviations.collect();
    let mean = moments::mean(deviations.into_iter());
    let message = format!("mean deviation of the rotations' columns from length 1: {mean:.2}");
    let allowed = Threshold::AtMost(MEAN_COLUMN_TOLERANCE);
    Check::new("rotation_columns", mean, allowed, message)
}

/// The contacts are those of slow feet, as [`Extraction`] labels them.
fn contacts(features: &Features, skeleton: &Skeleton) -> Check {
    let joints = features.joints();
    let feet = skeleton.contact_joints();
    let threshold = Extraction::default().contact_threshold;
    let agreeing = (1..joints.frames()).flat_map(|t| {
        let stated = &features.frame(t - 1)[features.layout().contacts()];
        let (here, next) = (joints.frame(t - 1), joints.frame(t));
        let labels = stated.iter().zip(feet).map(|(label, joint)| {
            let step = minus(next[joint], here[joint]);
            f64::from(u8::from((*label > 0.5) == (dot(step, step) < threshold)))
        });
        labels.collect::<Vec<_>>()
    });
    let agreeing: Vec<f64> = agreeing.collect();
    let share = moments::mean(agreeing.into_iter());
    let message = format!("share of the contacts that agree with the feet's steps: {share:.2}");
    Check::new(
        "contacts",
        share,
        Threshold::AtLeast(AGREEING_CONTACTS),
        message,
    )
}

/// Files contain metres.
fn metres(unit: f64) -> Check {
    let message = format!("a unit of the positions is {unit} m by the size of the body");
    Check::new("units", unit, Threshold::Within([1.0, 1.0]), message)
}

/// Metres per unit of the positions: joints are at most about a metre from the root.
fn unit_of(joints: &Joints) -> f64 {
    /// Metres in a centimetre.
    const CENTIMETRE: f64 = 1e-2;
    let frames = joints.frames();
    let reach = |t: usize| {
        let frame = joints.frame(t);
        let from_root = frame.iter().map(|place| length(minus(*place, frame[0])));
        from_root.fold(0.0, f64::max)
    };
    match (0..frames).map(reach).sum::<f64>() / frames as f64 {
        200.0.. => MILLIMETRE,
        10.0.. => CENTIMETRE,
        _ => 1.0,
    }
}

/// Ground path of a root, `[frames, 2]`: x and z in metres.
#[derive(Clone, Copy, Debug)]
pub struct GroundPath {
    /// Frames per second.
    pub fps: f64,
}

impl Representation for GroundPath {
    fn name(&self) -> String {
        "ground path".to_owned()
    }

    fn channels(&self) -> usize {
        2
    }

    fn fps(&self) -> f64 {
        self.fps
    }

    fn at_rate(&self, fps: f64) -> Option<Box<dyn Representation>> {
        Some(Box::new(Self { fps }))
    }

    fn channel_name(&self, channel: usize) -> String {
        ["x", "z"][channel].to_owned()
    }

    /// The root on the ground.
    fn joints(&self, rows: &[f32]) -> Option<Joints> {
        let frames = rows.chunks_exact(2);
        let places = frames.map(|place| [place[0].into(), 0.0, place[1].into()]);
        Joints::new(places.collect(), 1).ok()
    }

    /// Position, speed and jerk of the root.
    fn curves(&self, rows: &[f32]) -> Vec<Curves> {
        let mut all = vec![Curves::channels("position (m)", rows, 2, 0..2, &["x", "z"])];
        if let Some(joints) = self.joints(rows) {
            all.extend(curves(&joints, None, self.fps).into_iter().skip(1));
        }
        all
    }
}

/// Curves of a body: heights and speeds of root and feet, jerk.
pub(super) fn curves(joints: &Joints, skeleton: Option<&Skeleton>, fps: f64) -> Vec<Curves> {
    let heights = |joint| -> Vec<f64> { joints.track(joint).iter().map(|[_, y, _]| *y).collect() };
    let speeds = |joint| -> Vec<f64> {
        let velocity = differences(&joints.track(joint), fps).into_iter();
        velocity.map(|[x, _, z]| x.hypot(z)).collect()
    };
    let jerk = |joint| jerk_of(&joints.track(joint), fps);
    let jerks: Vec<Vec<[f64; 3]>> = (0..joints.joints()).map(jerk).collect();
    let steps = 0..jerks[0].len();
    let mean =
        |t: usize| jerks.iter().map(|jerk| length(jerk[t])).sum::<f64>() / jerks.len() as f64;
    let mut named = vec![("root", 0)];
    if let Some(skeleton) = skeleton {
        let [_, left, _, right] = skeleton.contact_joints();
        named.extend([("left foot", left), ("right foot", right)]);
    }
    let of = |numbers: &dyn Fn(usize) -> Vec<f64>| {
        let series = named
            .iter()
            .map(|&(name, joint)| (name.to_owned(), numbers(joint)));
        series.collect()
    };
    let jerk = vec![("|jerk|".into(), steps.map(mean).collect())];
    vec![
        Curves::new("height (m)", of(&heights)),
        Curves::new("speed on the ground (m/s)", of(&speeds)),
        Curves::new("jerk, mean over joints (m/s³)", jerk),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::representation::{Measured, statistics_of};

    fn representation() -> JointFeatures {
        JointFeatures {
            skeleton: Skeleton::humanml3d(),
            root: Root::Relative,
        }
    }

    /// A clip whose values vary by channel and frame. The contact flags are 1.
    fn clip(frames: usize, scale: f32) -> Vec<f32> {
        let layout = representation().layout();
        let channels = layout.channels();
        let value = |i: usize| match layout.contacts().contains(&(i % channels)) {
            true => 1.0,
            false => scale * ((i * 7919) % 101) as f32 - 3.0,
        };
        (0..frames * channels).map(value).collect()
    }

    #[test]
    fn a_group_shares_its_deviation_and_a_constant_group_has_one() {
        let (clip, layout) = (clip(30, 0.3), representation().layout());
        let statistics = statistics_of(&representation(), [&clip[..]]).unwrap();
        for group in layout.groups() {
            let std = &statistics.std[group];
            assert!(std.iter().all(|value| *value == std[0]));
        }
        assert_eq!(statistics.std[layout.contacts()], [1.0; 4]);
        assert_eq!(
            (statistics.root, statistics.items),
            (Some(Root::Relative), 1)
        );
    }

    #[test]
    fn merged_clips_are_measured_as_one() {
        let clips = [clip(5, 0.01), clip(40, 1.0), clip(9, -2.0)];
        let of = |rows: &[f32]| Measured::of(&representation(), rows);
        let mut merged = of(&clips[0]);
        clips[1..].iter().for_each(|clip| merged.merge(of(clip)));
        let all = of(&clips.concat());
        for channel in 0..263 {
            let (a, b) = (merged.moments(), all.moments());
            assert!((a.mean[channel] - b.mean[channel]).abs() < 1e-12);
            assert!((a.std[channel] - b.std[channel]).abs() < 1e-12);
        }
    }

    #[test]
    fn positions_in_other_units_are_read_in_metres() {
        let skeleton = Skeleton::kit();
        let representation = JointPositions {
            skeleton: skeleton.clone(),
        };
        let joints = crate::humanml::test_clip(&skeleton, 4);
        let metres = representation.joints(&joints.to_f32()).unwrap();
        for unit in [1e3, 1e2] {
            let large: Vec<f32> = joints.to_f32().iter().map(|value| unit * value).collect();
            let found = representation.joints(&large).unwrap();
            let pairs = found.as_slice().iter().zip(metres.as_slice());
            for (a, b) in pairs.flat_map(|(a, b)| a.iter().zip(b)) {
                assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
        // On a roof.
        let high: Vec<f32> = joints.to_f32().iter().map(|value| value + 30.0).collect();
        let found = representation.joints(&high).unwrap();
        assert!((found.frame(0)[0][1] - metres.frame(0)[0][1] - 30.0).abs() < 1e-4);
    }

    #[test]
    fn normalised_features_are_implausible() {
        let problem = representation().implausible(&clip(3, 0.01)).unwrap();
        assert!(
            problem.contains("joint rotations are invalid in frame 0"),
            "{problem}"
        );
    }
}
