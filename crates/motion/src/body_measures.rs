//! Measures of how a body moves, from the positions of its joints.

use crate::derivatives::jerk_of;
use crate::humanml::{Joints, Skeleton};
use crate::metrics::{fastest_step, jerk_norms, lowest_heights, mean_jerk, sliding_ratio};
use crate::moments;
use crate::quantiles::{median, percentile};
use crate::sanity::{Bounds, FACTOR, Margin};
use crate::vector::{dot, length, minus, plus};

/// A joint slower than this is still, metres per second.
const STILL_SPEED: f64 = 0.02;

/// Added to the speed of the limbs in [`BodyMeasure::Glide`], metres per second.
const GLIDE_OFFSET: f64 = 0.05;

/// A measure of how a body moves.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum BodyMeasure {
    /// Largest speed of the root on the ground, metres per second.
    FastestRoot,
    /// Mean speed of the joints, metres per second.
    MeanSpeed,
    /// 99th percentile over joints and frames of the speed, metres per second.
    Speed99,
    /// Largest speed of a joint, metres per second.
    FastestJoint,
    /// Mean jerk norm of the joints, metres per second cubed.
    MeanJerk,
    /// 99th percentile over joints and frames of the jerk norm, metres per second cubed.
    Jerk99,
    /// Largest jerk norm of a joint, metres per second cubed.
    LargestJerk,
    /// Largest angle between the axes across hips and shoulders of neighbouring frames, degrees per
    /// second.
    LargestTurn,
    /// Share of the steps between frames in which no joint moves.
    StillShare,
    /// Mean speed of the root on the ground divided by the mean speed of the joints around it, to
    /// which 0.05 m/s are added. A statue that is carried around has a large value.
    Glide,
    /// Share of the steps in which a foot slides ([`sliding_ratio`]).
    Skating,
    /// Lowest height of a joint, metres.
    Lowest,
    /// Median over the frames of the lowest joint's height, metres: a body that hangs over the floor
    /// has a large value.
    Floating,
    /// Median height of the root, in lengths of the leg.
    RootHeight,
    /// Length of the legs, metres.
    LegLength,
}

/// A value of a [`BodyMeasure`], with the frame and joint of an extreme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyValue {
    /// The value, in the measure's unit.
    pub value: f64,
    /// The frame of an extreme; of a step the frame that it ends in.
    pub frame: Option<usize>,
    /// The joint, if the value is an extreme over joints.
    pub joint: Option<usize>,
}

impl BodyMeasure {
    /// All measures.
    pub const ALL: [Self; 15] = [
        Self::FastestRoot,
        Self::MeanSpeed,
        Self::Speed99,
        Self::FastestJoint,
        Self::MeanJerk,
        Self::Jerk99,
        Self::LargestJerk,
        Self::LargestTurn,
        Self::StillShare,
        Self::Glide,
        Self::Skating,
        Self::Lowest,
        Self::Floating,
        Self::RootHeight,
        Self::LegLength,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::FastestRoot => "fastest_root",
            Self::MeanSpeed => "mean_speed",
            Self::Speed99 => "speed_p99",
            Self::FastestJoint => "fastest_joint",
            Self::MeanJerk => "mean_jerk",
            Self::Jerk99 => "jerk_p99",
            Self::LargestJerk => "largest_jerk",
            Self::LargestTurn => "largest_turn",
            Self::StillShare => "still_share",
            Self::Glide => "glide",
            Self::Skating => "skating",
            Self::Lowest => "floor",
            Self::Floating => "floating",
            Self::RootHeight => "root_height",
            Self::LegLength => "leg_length",
        }
    }

    /// Its description, for messages.
    pub fn title(self) -> &'static str {
        match self {
            Self::FastestRoot => "largest speed of the root",
            Self::MeanSpeed => "mean speed of the joints",
            Self::Speed99 => "99th percentile of the joints' speed",
            Self::FastestJoint => "largest speed of a joint",
            Self::MeanJerk => "mean jerk of the joints",
            Self::Jerk99 => "99th percentile of the joints' jerk",
            Self::LargestJerk => "largest jerk of a joint",
            Self::LargestTurn => "largest turn rate of the body",
            Self::StillShare => "share of the steps without movement",
            Self::Glide => "speed of the root relative to that of the limbs",
            Self::Skating => "share of the steps in which a foot slides",
            Self::Lowest => "height of the lowest joint",
            Self::Floating => "median height of the lowest joint",
            Self::RootHeight => "median height of the root in lengths of the leg",
            Self::LegLength => "length of the legs",
        }
    }

    /// Its unit, empty for a ratio.
    pub fn unit(self) -> &'static str {
        match self {
            Self::FastestRoot | Self::MeanSpeed | Self::Speed99 | Self::FastestJoint => "m/s",
            Self::MeanJerk | Self::Jerk99 | Self::LargestJerk => "m/s^3",
            Self::LargestTurn => "degrees/s",
            Self::Lowest | Self::Floating | Self::LegLength => "m",
            Self::StillShare | Self::Glide | Self::Skating | Self::RootHeight => "",
        }
    }

    /// The sides on which it is checked, and by which factor.
    pub fn bounds(self) -> Bounds {
        let margin = |share, least| Margin { share, least };
        match self {
            Self::FastestRoot => Bounds::UpperBeyond {
                factor: FACTOR,
                harmless: 1.0,
                end: f64::INFINITY,
            },
            Self::FastestJoint => Bounds::UpperBeyond {
                factor: FACTOR,
                harmless: 3.0,
                end: f64::INFINITY,
            },
            Self::LargestTurn => Bounds::UpperBeyond {
                factor: FACTOR,
                harmless: 360.0,
                end: f64::INFINITY,
            },
            Self::Jerk99 | Self::LargestJerk => Bounds::Upper(FACTOR),
            // The extremes are checked, and the mean jerk against the 95th percentile.
            Self::MeanSpeed | Self::Speed99 | Self::MeanJerk => Bounds::Unchecked,
            Self::Glide => Bounds::Upper(FACTOR),
            Self::StillShare => Bounds::NotAbove(margin(0.0, 0.3)),
            Self::Skating => Bounds::NotAbove(margin(0.0, 0.2)),
            Self::Lowest => Bounds::NotBelow(margin(0.0, 0.05)),
            Self::Floating => Bounds::NotAbove(margin(0.0, 0.05)),
            Self::RootHeight => Bounds::Around(margin(0.2, 0.0)),
            Self::LegLength => Bounds::Around(margin(0.3, 0.0)),
        }
    }

    /// Whether it exists of a lone root.
    fn is_of_a_root(self) -> bool {
        matches!(self, Self::FastestRoot | Self::Jerk99)
    }

    /// Whether it is a speed or a jerk. Motion beyond [`FAR`](Self::FAR) times their bound is not
    /// usable.
    pub fn is_of_speed(self) -> bool {
        let jerk = matches!(self, Self::Jerk99 | Self::LargestJerk);
        jerk || matches!(self, Self::FastestRoot | Self::FastestJoint)
    }

    /// Multiple of the bound of a speed or a jerk from which on a motion is not usable.
    pub const FAR: f64 = 2.0;

    /// Its value; `None` if the clip is too short, the skeleton has no legs, or the measure needs a
    /// skeleton that is not given. A root alone has speed and jerk.
    pub fn of(self, joints: &Joints, skeleton: Option<&Skeleton>, fps: f64) -> Option<BodyValue> {
        if joints.joints() == 1 && !self.is_of_a_root() {
            return None;
        }
        let frames = joints.frames();
        let steps = 0..frames - 1;
        let peak = |value, frame, joint| BodyValue {
            value,
            frame,
            joint,
        };
        let mean = |value: f64| peak(value, None, None);
        let step =
            |t: usize, joint: usize| minus(joints.frame(t + 1)[joint], joints.frame(t)[joint]);
        let joint_speed = |(t, joint): (usize, usize)| fps * length(step(t, joint));
        let root_speed = |t: usize| {
            let [x, _, z] = step(t, 0);
            fps * x.hypot(z)
        };
        let each = || {
            steps
                .clone()
                .flat_map(|t| (0..joints.joints()).map(move |j| (t, j)))
        };
        match self {
            Self::FastestRoot => {
                let ground = joints.track(0).into_iter().map(|[x, _, z]| [x, z]);
                let fastest = fastest_step(&ground.collect::<Vec<_>>(), fps)?;
                Some(peak(fastest.speed, Some(fastest.frame), Some(0)))
            }
            Self::MeanSpeed => {
                let speeds: Vec<f64> = each().map(joint_speed).collect();
                (!speeds.is_empty()).then(|| mean(moments::mean(speeds.into_iter())))
            }
            Self::Speed99 => {
                let speeds: Vec<f64> = each().map(joint_speed).collect();
                (!speeds.is_empty()).then(|| mean(percentile(speeds, 99.0)))
            }
            Self::FastestJoint => {
                let fastest = extreme(each().map(|at| (at, joint_speed(at))));
                fastest.map(|((t, joint), value)| peak(value, Some(t + 1), Some(joint)))
            }
            Self::Jerk99 => {
                let jerks = jerk_norms(joints, fps);
                (!jerks.is_empty()).then(|| mean(percentile(jerks, 99.0)))
            }
            Self::MeanJerk => mean_jerk(joints, fps).map(mean),
            Self::LargestJerk => {
                let jerks = (0..joints.joints()).flat_map(|joint| {
                    let jerks = jerk_of(&joints.track(joint), fps).into_iter().enumerate();
                    // A jump into a frame has its largest jerk two frames earlier.
                    jerks.map(move |(t, jerk)| ((t + 2, joint), length(jerk)))
                });
                let largest = extreme(jerks);
                largest.map(|((t, joint), value)| peak(value, Some(t), Some(joint)))
            }
            Self::LargestTurn => {
                let face = skeleton?.description().face_joints;
                let across = |t: usize| {
                    let at = |joint: usize| joints.frame(t)[joint];
                    let hips = minus(at(face.left_hip), at(face.right_hip));
                    plus(hips, minus(at(face.left_shoulder), at(face.right_shoulder)))
                };
                let turn = |t: usize| {
                    let (a, b) = (across(t), across(t + 1));
                    let cosine = dot(a, b) / (length(a) * length(b)).max(f64::MIN_POSITIVE);
                    fps * cosine.clamp(-1.0, 1.0).acos().to_degrees()
                };
                let largest = extreme(steps.map(|t| (t, turn(t))));
                largest.map(|(t, value)| peak(value, Some(t + 1), None))
            }
            Self::StillShare => {
                let moves =
                    |t: usize| (0..joints.joints()).any(|j| joint_speed((t, j)) >= STILL_SPEED);
                let still = steps.clone().filter(|&t| !moves(t)).count();
                (frames > 1).then(|| mean(still as f64 / steps.len() as f64))
            }
            Self::Glide => {
                let around =
                    |(t, joint): (usize, usize)| fps * length(minus(step(t, joint), step(t, 0)));
                let limbs = each().map(around).sum::<f64>() / each().count().max(1) as f64;
                let root = steps.clone().map(root_speed).sum::<f64>() / steps.len().max(1) as f64;
                (frames > 1).then(|| mean(root / (limbs + GLIDE_OFFSET)))
            }
            Self::Skating => {
                let [_, left, _, right] = skeleton?.contact_joints();
                sliding_ratio(joints, fps, &[left, right]).map(mean)
            }
            Self::Lowest => {
                let depth = |(t, joint): (usize, usize)| -joints.frame(t)[joint][1];
                let all = (0..frames).flat_map(|t| (0..joints.joints()).map(move |j| (t, j)));
                let lowest = extreme(all.map(|at| (at, depth(at))));
                lowest.map(|((t, joint), depth)| peak(-depth, Some(t), Some(joint)))
            }
            Self::Floating => Some(mean(median(lowest_heights(joints)))),
            Self::RootHeight => {
                let leg = leg_length(joints, skeleton?)?;
                let heights = joints.track(0).iter().map(|place| place[1]).collect();
                (leg > f64::EPSILON).then(|| mean(median(heights) / leg))
            }
            Self::LegLength => leg_length(joints, skeleton?).map(mean),
        }
    }
}

/// The first of the largest values, with its place.
fn extreme<P>(values: impl Iterator<Item = (P, f64)>) -> Option<(P, f64)> {
    values.reduce(|best, other| if other.1 > best.1 { other } else { best })
}

/// Mean length of thigh and shank, metres.
fn leg_length(joints: &Joints, skeleton: &Skeleton) -> Option<f64> {
    let legs = skeleton.legs();
    let first = joints.frame(0);
    let of = |leg: &crate::feet::Leg| {
        let bone = |a: usize, b: usize| length(minus(first[a], first[b]));
        bone(leg.hip, leg.knee) + bone(leg.knee, leg.ankle)
    };
    (!legs.is_empty()).then(|| legs.iter().map(of).sum::<f64>() / legs.len() as f64)
}
