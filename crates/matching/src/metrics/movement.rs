//! Physical measures of a new motion beside those of its examples.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::vector::length;
use serde::Serialize;

use crate::{MotionMatrix, feet, jerks, percentile_95};

/// Height above the floor of a low toe, in body heights.
const LOW: f64 = 0.03;
/// Percentile of a toe's heights in the examples that is the floor.
const FLOOR: f64 = 0.05;
/// Speed of a still frame, as a part of the examples' median.
const STILL: f64 = 0.1;
/// Largest ratios to the examples.
const TOE: f64 = 1.3;
const JERK: f64 = 1.5;
const FASTEST: f64 = 1.5;
const TURN: f64 = 2.0;
/// Largest excess of the share of still frames.
const STILLER: f64 = 0.05;
/// Smallest mean speed and speed of the fastest joint, as parts of the examples'.
const SLOWEST: f64 = 0.6;
const SLOWEST_JOINT: f64 = 0.3;
/// Toe speed in body heights a second, and degrees of a turn, that are always allowed.
const HARMLESS_TOE: f64 = 0.005;
const HARMLESS_TURN: f64 = 10.0;

/// Physical measures of motions, in file units, or in metres ([`Quality::in_metres`]), and seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Movement {
    /// Mean horizontal speed of toes within 0.03 body heights of the floor; none without feet.
    pub toe_speed_while_low: Option<f64>,
    /// The 95th percentile of jerk: the mean length of the joints' third differences.
    pub jerk: f64,
    /// Largest speed of a joint.
    pub fastest_joint: f64,
    /// Part of the frames whose mean joint speed is below a tenth of the examples' median.
    pub still_share: f64,
    /// Largest rotation of the root joint from one frame to the next, in degrees.
    pub largest_turn: f64,
    /// Mean speed of the joints.
    pub mean_speed: f64,
    /// Frame and joint of `fastest_joint`.
    pub fastest_at: (usize, String),
    /// Frame of `largest_turn`.
    pub turn_at: usize,
}

/// A motion beside its examples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// The new motion.
    pub motion: Movement,
    /// The examples: means over all their frames and the largest of all.
    pub examples: Movement,
    /// Height of the body, in their units.
    #[serde(skip)]
    height: f64,
}

/// A measure, its name, the bound that it must not exceed, and a description of where it is largest.
struct Bounded {
    name: &'static str,
    value: f64,
    example: f64,
    bound: f64,
    at: String,
}

/// Measures of motions that are compared with the same examples.
pub(crate) struct Reference {
    root: usize,
    up: usize,
    frame_time: f64,
    height: f64,
    names: Vec<String>,
    /// The last joint of each foot and the height of its floor.
    toes: Vec<(usize, f64)>,
    /// Speed below which a frame is still.
    still: f64,
    examples: Movement,
}

type World = Vec<Vec<RootPose>>;

fn world(bvh: &Bvh) -> World {
    (0..bvh.frames()).map(|t| bvh.world(t)).collect()
}

fn apart(a: &RootPose, b: &RootPose) -> [f64; 3] {
    [0, 1, 2].map(|axis| b.position[axis] - a.position[axis])
}

/// Mean of numbers; 0 of none.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values
}

impl Reference {
    /// The reference of examples; none without frames.
    pub(crate) fn new(layout: &MotionMatrix, examples: &[Bvh]) -> Option<Self> {
        let worlds: Vec<World> = examples.iter().map(world).collect();
        let joints = layout.joints();
        let feet = feet(joints);
        let up = layout.up as usize;
        let inner = |&&foot: &&usize| !feet.iter().any(|&other| joints[other].parent == Some(foot));
        let floor = |toe: usize| {
            let heights = worlds.iter().flatten().map(|frame| frame[toe].position[up]);
            let heights = sorted(heights.collect());
            heights[(FLOOR * heights.len() as f64) as usize]
        };
        let spans = worlds.iter().flatten().map(|frame| {
            let heights = sorted(frame.iter().map(|pose| pose.position[up]).collect());
            heights.last().unwrap_or(&0.0) - heights.first().unwrap_or(&0.0)
        });
        let spans: Vec<f64> = spans.collect();
        if spans.is_empty() {
            return None;
        }
        let mut reference = Self {
            root: layout.root_joint,
            up,
            frame_time: layout.frame_time(),
            height: mean(&spans),
            names: joints.iter().map(|joint| joint.name.clone()).collect(),
            toes: feet
                .iter()
                .filter(inner)
                .map(|&toe| (toe, floor(toe)))
                .collect(),
            still: 0.0,
            examples: Movement::default(),
        };
        let speeds = worlds.iter().flat_map(|world| reference.speeds(world));
        // Repeated frames are excluded from the median.
        let moving = sorted(
            speeds
                .filter(|speed| *speed > 1e-6 * reference.height)
                .collect(),
        );
        reference.still = STILL * moving.get(moving.len() / 2).copied().unwrap_or(0.0);
        reference.examples = reference.measured(examples, &worlds);
        Some(reference)
    }

    /// A motion beside the examples.
    pub(crate) fn quality(&self, motion: &Bvh) -> Quality {
        Quality {
            motion: self.measured(std::slice::from_ref(motion), &[world(motion)]),
            examples: self.examples.clone(),
            height: self.height,
        }
    }

    /// Mean joint speed of each frame but the first.
    fn speeds(&self, world: &World) -> Vec<f64> {
        let speed = |pair: &[Vec<RootPose>]| {
            let moved = pair[0]
                .iter()
                .zip(&pair[1])
                .map(|(a, b)| length(apart(a, b)));
            mean(&moved.collect::<Vec<_>>()) / self.frame_time
        };
        world.windows(2).map(speed).collect()
    }

    fn measured(&self, motions: &[Bvh], worlds: &[World]) -> Movement {
        let third = self.frame_time.powi(3);
        let jerks: Vec<f64> = motions.iter().flat_map(jerks).collect();
        let speeds = worlds.iter().flat_map(|world| self.speeds(world));
        let speeds: Vec<f64> = speeds.collect();
        let still = speeds.iter().filter(|speed| **speed < self.still).count();
        let mut movement = Movement {
            jerk: percentile_95(&jerks) / third,
            still_share: still as f64 / speeds.len().max(1) as f64,
            mean_speed: mean(&speeds),
            ..Movement::default()
        };
        let mut low = Vec::new();
        for pair in worlds.iter().flat_map(|world| world.windows(2).enumerate()) {
            let (t, [before, now]) = (pair.0 + 1, [&pair.1[0], &pair.1[1]]);
            for (joint, (a, b)) in before.iter().zip(now).enumerate() {
                let speed = length(apart(a, b)) / self.frame_time;
                if speed > movement.fastest_joint {
                    movement.fastest_joint = speed;
                    movement.fastest_at = (t, self.names[joint].clone());
                }
            }
            let turn = now[self.root].orientation * before[self.root].orientation.conjugate();
            let turn = 2.0 * turn.w.abs().min(1.0).acos().to_degrees();
            if turn > movement.largest_turn {
                (movement.largest_turn, movement.turn_at) = (turn, t);
            }
            for &(toe, floor) in &self.toes {
                let is_low = |pose: &RootPose| pose.position[self.up] - floor < LOW * self.height;
                if is_low(&before[toe]) && is_low(&now[toe]) {
                    let mut moved = apart(&before[toe], &now[toe]);
                    moved[self.up] = 0.0;
                    low.push(length(moved) / self.frame_time);
                }
            }
        }
        movement.toe_speed_while_low = (!low.is_empty()).then(|| mean(&low));
        movement
    }
}

impl Movement {
    fn scaled(self, by: f64) -> Self {
        Self {
            toe_speed_while_low: self.toe_speed_while_low.map(|speed| by * speed),
            jerk: by * self.jerk,
            fastest_joint: by * self.fastest_joint,
            mean_speed: by * self.mean_speed,
            ..self
        }
    }
}

impl Quality {
    /// The measures in metres, of motions in units of so many metres.
    #[must_use]
    pub fn in_metres(self, metres_per_unit: f64) -> Self {
        Self {
            motion: self.motion.scaled(metres_per_unit),
            examples: self.examples.scaled(metres_per_unit),
            height: metres_per_unit * self.height,
        }
    }

    /// The measures that a motion must not exceed. `harmless`: toe speed that is always allowed, in
    /// body heights a second.
    fn bounded(&self, harmless: f64) -> Vec<Bounded> {
        let (motion, examples) = (&self.motion, &self.examples);
        let bounded = |name, value, example, bound, at| Bounded {
            name,
            value,
            example,
            bound,
            at,
        };
        let mut all = Vec::new();
        if let (Some(toe), Some(example)) =
            (motion.toe_speed_while_low, examples.toe_speed_while_low)
        {
            let bound = (TOE * example).max(harmless * self.height);
            let name = "toe speed while low";
            all.push(bounded(name, toe, example, bound, String::new()));
        }
        let (jerk, fastest) = (examples.jerk, examples.fastest_joint);
        let (frame, joint) = &motion.fastest_at;
        let at = format!(" ({joint}, frame {frame})");
        let turn = (TURN * examples.largest_turn).max(HARMLESS_TURN);
        let turned = format!(" (frame {})", motion.turn_at);
        let still = examples.still_share;
        all.extend([
            bounded("jerk", motion.jerk, jerk, JERK * jerk, String::new()),
            bounded(
                "fastest joint",
                motion.fastest_joint,
                fastest,
                FASTEST * fastest,
                at,
            ),
            bounded(
                "largest turn",
                motion.largest_turn,
                examples.largest_turn,
                turn,
                turned,
            ),
            bounded(
                "still share",
                motion.still_share,
                still,
                still + STILLER,
                String::new(),
            ),
        ]);
        all
    }

    /// The speeds that a motion must reach, each with its name and bound.
    fn least_speeds(&self) -> [(&'static str, f64, f64); 2] {
        let (motion, examples) = (&self.motion, &self.examples);
        let mean = SLOWEST * examples.mean_speed;
        let fastest = SLOWEST_JOINT * examples.fastest_joint;
        [
            ("mean speed", motion.mean_speed, mean),
            ("fastest joint", motion.fastest_joint, fastest),
        ]
    }

    /// The largest measure relative to its bound: at most 1 for a motion within all bounds. Speeds
    /// below their bounds count squared, because a motion that slides is better than one that
    /// freezes.
    pub fn excess(&self) -> f64 {
        self.excess_beside(HARMLESS_TOE)
    }

    /// [`Self::excess`] if no toe speed above the examples' is harmless.
    pub(crate) fn strict_excess(&self) -> f64 {
        self.excess_beside(0.0)
    }

    fn excess_beside(&self, harmless: f64) -> f64 {
        let tiny = 1e-9 * self.height.max(f64::MIN_POSITIVE);
        let of = |each: Bounded| each.value / each.bound.max(tiny);
        let bounded = self.bounded(harmless).into_iter();
        let excess = bounded.map(of).fold(0.0, f64::max);
        let slower = |(_, speed, least): (_, f64, f64)| (least / speed.max(tiny)).powi(2);
        self.least_speeds()
            .map(slower)
            .into_iter()
            .fold(excess, f64::max)
    }

    /// The measures beyond their bounds, each with its value, that of the examples, the bound, and
    /// frame and joint.
    pub fn beyond(&self) -> Vec<String> {
        let bounded = self.bounded(HARMLESS_TOE).into_iter();
        let beyond = bounded.filter(|each| each.value > each.bound);
        let text = |each: Bounded| {
            format!(
                "{} {:.3}{}, examples {:.3}, bound {:.3}",
                each.name, each.value, each.at, each.example, each.bound
            )
        };
        let mut all: Vec<String> = beyond.map(text).collect();
        let slow = self.least_speeds().into_iter();
        let slow = slow.filter(|(_, speed, least)| speed < least);
        all.extend(slow.map(|(name, speed, least)| {
            format!("{name} {speed:.3}, at least {least:.3} expected")
        }));
        all
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::MatrixOptions;
    use crate::motion_matrix::tests::example;

    #[test]
    fn a_copy_is_within_all_bounds_and_a_jump_names_its_frame_and_joint() {
        let walk = example("walk.bvh", 60, 1.0 / 30.0);
        let examples = std::slice::from_ref(&walk);
        let layout = MotionMatrix::new(examples, MatrixOptions::default()).unwrap();
        let reference = Reference::new(&layout, std::slice::from_ref(&walk.bvh)).unwrap();
        let copy = reference.quality(&walk.bvh);
        assert_eq!(copy.motion, copy.examples);
        assert!(copy.excess() <= 1.0 && copy.beyond().is_empty());
        let joints = walk.bvh.joints().len();
        let bvh = &walk.bvh;
        let locals = |last: usize| (0..60).flat_map(move |t: usize| bvh.locals(t.min(last)));
        let still: Vec<RootPose> = locals(29).collect();
        let still = walk.bvh.reposed(1.0 / 30.0, &still).unwrap();
        let stopped = reference.quality(&still);
        assert!((stopped.motion.still_share - 30.0 / 59.0).abs() < 1e-9);
        assert!(
            stopped
                .beyond()
                .iter()
                .any(|line| line.contains("still share"))
        );
        let mut turned: Vec<RootPose> = locals(59).collect();
        let about = kinegrad_motion::Quaternion::from_yaw(3.0);
        for pose in turned.chunks_mut(joints).skip(40) {
            pose[layout.root_joint].orientation = about * pose[layout.root_joint].orientation;
        }
        let flip = walk.bvh.reposed(1.0 / 30.0, &turned).unwrap();
        let flip = reference.quality(&flip);
        assert_eq!((flip.motion.turn_at, flip.motion.fastest_at.0), (40, 40));
        let beyond = flip.beyond().join("\n");
        assert!(
            beyond.contains("largest turn") && beyond.contains("frame 40"),
            "{beyond}"
        );
    }

    /// A bow beside a motion of it, in metres: toe speed, jerk, fastest joint and mean speed.
    fn beside_a_bow([toe, jerk, fastest_joint, mean_speed]: [f64; 4]) -> Quality {
        let examples = Movement {
            toe_speed_while_low: Some(0.001),
            jerk: 14.7,
            fastest_joint: 1.24,
            largest_turn: 1.4,
            mean_speed: 0.073,
            ..Movement::default()
        };
        let motion = Movement {
            toe_speed_while_low: Some(toe),
            jerk,
            fastest_joint,
            mean_speed,
            ..examples.clone()
        };
        Quality {
            motion,
            examples,
            height: 1.37,
        }
    }

    #[test]
    fn a_frozen_gesture_is_worse_than_one_that_slides_or_shakes() {
        let harmless = beside_a_bow([0.006, 14.7, 1.24, 0.073]);
        assert!(harmless.excess() <= 1.0, "{}", harmless.excess());
        let frozen = beside_a_bow([0.006, 14.7, 0.05, 0.017]);
        let frozen_in_most_joints = beside_a_bow([0.006, 14.7, 0.05, 0.05]);
        let shaking = beside_a_bow([0.017, 65.0, 1.69, 0.088]);
        for frozen in [frozen, frozen_in_most_joints] {
            let (better, worse) = (shaking.excess(), frozen.excess());
            assert!(2.0 * better < worse, "{better} {worse}");
            let warnings = frozen.beyond().join("\n");
            assert!(
                warnings.contains("fastest joint 0.050, at least 0.372"),
                "{warnings}"
            );
        }
    }

    proptest! {
        #[test]
        fn motions_beyond_a_bound_have_a_warning(
            toe in 0.0..0.02f64, jerk in 10.0..30.0f64, fastest in 0.2..2.0f64, mean in 0.03..0.1f64,
        ) {
            let quality = beside_a_bow([toe, jerk, fastest, mean]);
            prop_assert_eq!(quality.excess() > 1.0, !quality.beyond().is_empty());
        }
    }
}
