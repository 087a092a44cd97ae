//! A walk along a path without foot sliding.
//!
//! The pelvis follows the path. For three fifths of a stride each foot stands on a footprint beside
//! the path. For two fifths the foot swings to the next footprint. Bones keep the skeleton's
//! lengths.

use super::Skeleton;
use crate::vector::{length, minus, plus};

/// Steps per second in the path's table.
const TABLE_RATE: f64 = 200.0;
/// Seconds of the path before the first and after the last frame.
const MARGIN_SECONDS: f64 = 3.0;
/// Share of a stride in which a foot stands.
const STANCE: f64 = 0.6;
/// Height of the ankle above the ground while the foot stands, metres.
const ANKLE_HEIGHT: f64 = 0.07;

type Point = [f64; 3];

/// Speed and turning of a walk.
pub struct Course {
    /// Speed in metres per second, by time in seconds.
    pub speed: Box<dyn Fn(f64) -> f64>,
    /// Turning in radians per second, from +z towards +x (to the left), by time in seconds.
    pub turning: Box<dyn Fn(f64) -> f64>,
}

/// The course as a table.
struct Path {
    start: f64,
    /// x, z, yaw and phase (number of strides) at each step.
    steps: Vec<[f64; 4]>,
}

impl Path {
    fn new(course: &Course, seconds: f64) -> Self {
        let start = -MARGIN_SECONDS;
        let count = ((seconds + 2.0 * MARGIN_SECONDS) * TABLE_RATE).ceil() as usize;
        let mut state = [0.0_f64; 4];
        let steps = (0..=count).map(|i| {
            let here = state;
            let time = start + i as f64 / TABLE_RATE;
            let (speed, yaw) = ((course.speed)(time), state[2]);
            // Faster walking has both longer and more frequent strides.
            let rates = [
                speed * yaw.sin(),
                speed * yaw.cos(),
                (course.turning)(time),
                0.55 + 0.35 * speed,
            ];
            for (value, rate) in state.iter_mut().zip(rates) {
                *value += rate / TABLE_RATE;
            }
            here
        });
        let steps = steps.collect();
        Self { start, steps }
    }

    /// x, z, yaw and phase at a time in seconds, clamped to the table.
    fn at(&self, time: f64) -> [f64; 4] {
        let last = self.steps.len() - 1;
        let place = ((time - self.start) * TABLE_RATE).clamp(0.0, last as f64);
        let before = (place as usize).min(last - 1);
        let weight = place - before as f64;
        let (from, to) = (self.steps[before], self.steps[before + 1]);
        plus(from, minus(to, from).map(|step| weight * step))
    }

    /// The time at which the phase is reached.
    fn time_of_phase(&self, phase: f64) -> f64 {
        let after = self.steps.partition_point(|step| step[3] < phase);
        let after = after.clamp(1, self.steps.len() - 1);
        let (a, b) = (self.steps[after - 1][3], self.steps[after][3]);
        let place = (after - 1) as f64 + (phase - a) / (b - a);
        self.start + place / TABLE_RATE
    }
}

/// The joints `[frames, 22, 3]` of a walk along `course`, metres, for HumanML3D's `skeleton`.
pub fn joints(course: &Course, skeleton: &Skeleton, frames: usize) -> Vec<Point> {
    let fps = skeleton.description().fps;
    let times: Vec<f64> = (0..frames).map(|frame| frame as f64 / fps).collect();
    joints_at(course, skeleton, frames as f64 / fps, &times)
}

/// The same at other `times` within a walk of so many `seconds`. A walk whose time runs faster at the
/// end of each step lands as people do; [`joints`] lift and land alike.
pub fn joints_at(course: &Course, skeleton: &Skeleton, seconds: f64, times: &[f64]) -> Vec<Point> {
    let path = Path::new(course, seconds);
    let walker = Walker::new(course, skeleton, seconds);
    times
        .iter()
        .flat_map(|time| walker.pose(&path, *time))
        .collect()
}

/// Sizes of a walker.
struct Walker<'a> {
    offsets: &'a [Point],
    /// Height of the pelvis above the ground.
    height: f64,
    /// Swing of the arms to either side, radians.
    arm_swing: f64,
    lean: f64,
}

impl<'a> Walker<'a> {
    fn new(course: &Course, skeleton: &'a Skeleton, seconds: f64) -> Self {
        let offsets = &skeleton.description().rest_offsets[..];
        let speeds = (0..=20).map(|i| (course.speed)(seconds * f64::from(i) / 20.0));
        let fastest = speeds.fold(0.0, f64::max);
        // At this height the rear leg reaches the ground until the end of the stance.
        let reach = 0.5 * STANCE * fastest / (0.55 + 0.35 * fastest) + 0.02;
        let leg = 0.985 * (length(offsets[4]) + length(offsets[7]));
        let stretched = (leg * leg - reach * reach).sqrt();
        Self {
            offsets,
            height: stretched - offsets[1][1] + ANKLE_HEIGHT,
            arm_swing: 0.1 + 0.3 * fastest,
            lean: 0.04 * fastest,
        }
    }

    /// The 22 joints at a time in seconds.
    fn pose(&self, path: &Path, time: f64) -> [Point; 22] {
        let [x, z, yaw, phase] = path.at(time);
        let bob = 0.012 * (2.0 * std::f64::consts::TAU * phase).cos();
        let mut pose = [[0.0; 3]; 22];
        pose[0] = [x, self.height - 0.012 + bob, z];
        let mut place = |joint: usize, parent: usize, offset: Point| {
            pose[joint] = plus(pose[parent], turned(offset, yaw));
        };
        for hip in [1, 2] {
            place(hip, 0, self.offsets[hip]);
        }
        for (joint, parent) in [(3, 0), (6, 3), (9, 6), (12, 9), (13, 9), (14, 9), (15, 12)] {
            place(joint, parent, pitched(self.offsets[joint], self.lean));
        }
        for (side, [shoulder, elbow, wrist], collar) in
            [(1.0, [16, 18, 20], 13), (-1.0, [17, 19, 21], 14)]
        {
            place(shoulder, collar, self.offsets[shoulder]);
            // Each arm swings with the opposite leg.
            let swing = -side * self.arm_swing * (std::f64::consts::TAU * phase).cos();
            for (joint, parent, angle) in [(elbow, shoulder, swing), (wrist, elbow, swing + 0.35)] {
                let hanging = [0.1 * side, -angle.cos(), angle.sin()];
                let bone = length(self.offsets[joint]) / length(hanging);
                place(joint, parent, hanging.map(|value| value * bone));
            }
        }
        for (side, [hip, knee, ankle, foot], ahead) in
            [(1.0, [1, 4, 7, 10], 0.0), (-1.0, [2, 5, 8, 11], 0.5)]
        {
            let (target, foot_yaw) = self.ankle(path, phase + ahead, ahead, side);
            let bones = [knee, ankle].map(|joint| length(self.offsets[joint]));
            let forward = turned([0.0, 0.0, 1.0], yaw);
            (pose[knee], pose[ankle]) = reach(pose[hip], target, bones, forward);
            pose[foot] = plus(pose[ankle], turned(self.offsets[foot], foot_yaw));
        }
        pose
    }

    /// Position of an ankle and heading of the foot, at a phase `ahead` of the path's phase.
    fn ankle(&self, path: &Path, phase: f64, ahead: f64, side: f64) -> (Point, f64) {
        let stride = phase.floor();
        let print = |stride: f64| {
            let time = path.time_of_phase(stride + 0.5 * STANCE - ahead);
            let [x, z, yaw, _] = path.at(time);
            let beside = turned([side * self.offsets[1][0].abs(), ANKLE_HEIGHT, 0.0], yaw);
            (plus([x, 0.0, z], beside), yaw)
        };
        let (from, from_yaw) = print(stride);
        let swing = (phase - stride - STANCE) / (1.0 - STANCE);
        if swing <= 0.0 {
            return (from, from_yaw);
        }
        let (to, to_yaw) = print(stride + 1.0);
        let done = swing.powi(3) * (10.0 - 15.0 * swing + 6.0 * swing * swing);
        let mut place: Point = std::array::from_fn(|i| from[i] + done * (to[i] - from[i]));
        place[1] += 0.1 * (std::f64::consts::PI * swing).sin().powi(2);
        (place, from_yaw + done * (to_yaw - from_yaw))
    }
}

/// Knee and ankle of a leg with these bones from `hip` towards `target`; the knee bends `forward`.
fn reach(hip: Point, target: Point, bones: [f64; 2], forward: Point) -> (Point, Point) {
    let [thigh, shank] = bones;
    let to_target = minus(target, hip);
    let (least, most) = ((thigh - shank).abs() + 1e-3, 0.999 * (thigh + shank));
    let along = to_target.map(|value| value / length(to_target));
    let distance = length(to_target).clamp(least, most);
    let ankle = std::array::from_fn(|i| hip[i] + distance * along[i]);
    let down = (thigh * thigh + distance * distance - shank * shank) / (2.0 * distance);
    let out = (thigh * thigh - down * down).max(0.0).sqrt();
    let part: f64 = forward.iter().zip(along).map(|(a, b)| a * b).sum();
    let across: Point = std::array::from_fn(|i| forward[i] - part * along[i]);
    let across = across.map(|value| value / length(across));
    let knee = std::array::from_fn(|i| hip[i] + down * along[i] + out * across[i]);
    (knee, ankle)
}

/// `vector` turned about +y, from +z towards +x.
fn turned([x, y, z]: Point, yaw: f64) -> Point {
    let (sin, cos) = yaw.sin_cos();
    [cos * x + sin * z, y, cos * z - sin * x]
}

/// `vector` turned about +x, from +y towards +z.
fn pitched([x, y, z]: Point, angle: f64) -> Point {
    let (sin, cos) = angle.sin_cos();
    [x, cos * y - sin * z, cos * z + sin * y]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(speed: f64, turning: f64) -> Course {
        Course {
            speed: Box::new(move |_| speed),
            turning: Box::new(move |_| turning),
        }
    }

    fn distance(a: Point, b: Point) -> f64 {
        length(minus(a, b))
    }

    #[test]
    fn bones_keep_their_lengths_and_feet_stay_where_they_are_set() {
        let skeleton = Skeleton::humanml3d();
        let offsets = &skeleton.description().rest_offsets;
        for (speed, turning) in [(0.6, 0.0), (1.1, 0.9), (1.6, -0.6)] {
            let joints = joints(&course(speed, turning), &skeleton, 160);
            let frames: Vec<&[Point]> = joints.chunks(22).collect();
            for frame in &frames {
                for (joint, parent) in skeleton.parents().iter().enumerate() {
                    let Some(parent) = *parent else { continue };
                    let found = distance(frame[joint], frame[parent]);
                    let expected = length(offsets[joint]);
                    assert!(
                        (found - expected).abs() < 1e-9,
                        "{joint}: {found} {expected}"
                    );
                }
                assert!((0.75..1.0).contains(&frame[0][1]), "{}", frame[0][1]);
            }
            for ankle in [7, 8] {
                let steps = frames
                    .windows(2)
                    .map(|pair| distance(pair[0][ankle], pair[1][ankle]));
                let still = steps.filter(|step| *step < 0.01).count();
                let share = still as f64 / 159.0;
                assert!((0.5..0.65).contains(&share), "{speed} {turning}: {share}");
                let height = |frame: &&[Point]| frame[ankle][1];
                let lowest = frames.iter().map(height).fold(f64::INFINITY, f64::min);
                assert!((lowest - ANKLE_HEIGHT).abs() < 0.01, "{lowest}");
            }
            let one_stands = frames.windows(2).filter(|pair| {
                [7, 8]
                    .iter()
                    .any(|&ankle| distance(pair[0][ankle], pair[1][ankle]) < 0.01)
            });
            assert!(one_stands.count() > 155);
        }
    }

    #[test]
    fn the_pelvis_follows_the_course() {
        let skeleton = Skeleton::humanml3d();
        let straight = joints(&course(1.0, 0.0), &skeleton, 41);
        let (first, last) = (straight[0], straight[40 * 22]);
        assert!((last[2] - first[2] - 2.0).abs() < 0.02 && (last[0] - first[0]).abs() < 1e-9);
        // The path is half a circle to the left, of radius 2 / pi.
        let turning = std::f64::consts::FRAC_PI_2;
        let half = joints(&course(1.0, turning), &skeleton, 41);
        let diameter = distance(half[0], half[40 * 22]);
        assert!(
            (diameter - 4.0 / std::f64::consts::PI).abs() < 0.03,
            "{diameter}"
        );
    }
}
