//! Physical measures of a new motion beside those of its examples.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::vector::{length, minus};
use serde::Serialize;

use super::quality::{Liveliest, Quality};
use crate::limit_jerk::third_difference;
use crate::{MotionMatrix, feet, jerks, percentile_95};

/// Height above the floor of a low toe, in body heights.
const LOW: f64 = 0.03;
/// Percentile of a toe's heights in the examples that is the floor.
const FLOOR: f64 = 0.05;
/// Displacement of a motion in place, in body heights.
const STRAY: f64 = 0.1;
/// Speed of a still frame, as a part of the examples' median.
const STILL: f64 = 0.1;

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
    /// Frame and joint of the largest jerk.
    pub jerk_at: (usize, String),
    /// Frame of `largest_turn`.
    pub turn_at: usize,
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
    liveliest: Liveliest,
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
    /// The reference of examples; none without frames. `others`: motions that parts and contents are
    /// taken from.
    pub(crate) fn new(layout: &MotionMatrix, examples: &[Bvh], others: &[Bvh]) -> Option<Self> {
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
            liveliest: Liveliest::default(),
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
        let others = others.iter();
        let others =
            others.map(|motion| reference.measured(std::slice::from_ref(motion), &[world(motion)]));
        let others: Vec<Movement> = others.collect();
        let all = || others.iter().chain([&reference.examples]);
        reference.liveliest = Liveliest {
            jerk: all().map(|each| each.jerk).fold(0.0, f64::max),
            fastest_joint: all().map(|each| each.fastest_joint).fold(0.0, f64::max),
        };
        Some(reference)
    }

    /// True if a root trajectory ends less than a tenth of the body's height from its start.
    pub(crate) fn strays(&self, path: &[[f64; 3]]) -> bool {
        let ends = path.first().zip(path.last());
        ends.is_some_and(|(a, b)| length(minus(*b, *a)) < STRAY * self.height)
    }

    /// A motion beside the examples.
    pub(crate) fn quality(&self, motion: &Bvh) -> Quality {
        Quality {
            motion: self.measured(std::slice::from_ref(motion), &[world(motion)]),
            examples: self.examples.clone(),
            height: self.height,
            liveliest: self.liveliest,
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
        movement.jerk_at = self.largest_jerk(worlds);
        movement
    }

    /// Frame and joint of the largest jerk; a jump into a frame has its largest jerk there.
    fn largest_jerk(&self, worlds: &[World]) -> (usize, String) {
        let (mut largest, mut at) = (0.0, (0, String::new()));
        for (t, four) in worlds.iter().flat_map(|world| world.windows(4).enumerate()) {
            for (joint, name) in self.names.iter().enumerate() {
                let jerk = third_difference(four, joint);
                if jerk > largest {
                    (largest, at) = (jerk, (t + 2, name.clone()));
                }
            }
        }
        at
    }
}

impl Movement {
    /// The measures in other units of length.
    pub(super) fn scaled(self, by: f64) -> Self {
        Self {
            toe_speed_while_low: self.toe_speed_while_low.map(|speed| by * speed),
            jerk: by * self.jerk,
            fastest_joint: by * self.fastest_joint,
            mean_speed: by * self.mean_speed,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::quality::{FASTEST, LIVELY_SPEED};
    use super::*;
    use crate::MatrixOptions;
    use crate::motion_matrix::tests::example;

    #[test]
    fn a_copy_is_within_all_bounds_and_a_jump_names_its_frame_and_joint() {
        let walk = example("walk.bvh", 60, 1.0 / 30.0);
        let examples = std::slice::from_ref(&walk);
        let layout = MotionMatrix::new(examples, MatrixOptions::default()).unwrap();
        let reference = Reference::new(&layout, std::slice::from_ref(&walk.bvh), &[]).unwrap();
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

    #[test]
    fn far_beyond_its_sources_a_motion_is_not_usable() {
        let walk = example("walk.bvh", 120, 1.0 / 30.0);
        let examples = std::slice::from_ref(&walk);
        let layout = MotionMatrix::new(examples, MatrixOptions::default()).unwrap();
        let joints = walk.bvh.joints().len();
        // The whole body jumps by so much into frame 40.
        let jump = |by: f64| {
            let mut poses: Vec<RootPose> = (0..120).flat_map(|t| walk.bvh.locals(t)).collect();
            for pose in poses.chunks_mut(joints).skip(40) {
                pose[0].position[0] += by;
            }
            walk.bvh.reposed(1.0 / 30.0, &poses).unwrap()
        };
        let originals = std::slice::from_ref(&walk.bvh);
        let reference = Reference::new(&layout, originals, &[]).unwrap();
        let own = reference.quality(&walk.bvh);
        assert!(!own.is_far());
        // A step faster than both bounds, and one between the bound of warnings and that bound.
        let bound =
            (FASTEST * own.examples.fastest_joint).max(LIVELY_SPEED * reference.height) / 30.0;
        let far = reference.quality(&jump(2.5 * bound));
        assert!(far.is_far());
        let beyond = far.beyond().join("\n");
        let place = format!("({}, frame 40)", far.motion.fastest_at.1);
        assert!(
            beyond.contains("fastest joint") && beyond.contains(&place),
            "{beyond}"
        );
        assert!(beyond.contains("this motion is not usable"), "{beyond}");
        assert_eq!(far.motion.jerk_at.0, 40);
        assert!(far.clone().in_metres(0.01).is_far());
        assert!(!reference.quality(&jump(0.5 * bound)).is_far());
        // A source that is as fast makes it usable.
        let others = [jump(2.5 * bound)];
        let reference = Reference::new(&layout, originals, &others).unwrap();
        assert!(!reference.quality(&jump(2.5 * bound)).is_far());
    }
}
