//! Jerk around what a motion must keep to, brought near that of the rest.
//!
//! A pose from a fast second of an example in an else quiet motion, and a body that is put together
//! over the legs of another, jerk more than what is around them. Both are smoothed as much as is
//! needed and no more; what is held stays as it is.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::Quaternion;
use kinegrad_motion::rotation::length;

use crate::smoothing::smooth;
use crate::{Constraint, Error, Frames, MotionMatrix, rotation6d};

/// Mean jerk of the second around a key frame, as a part of that elsewhere, at most.
const AROUND: f64 = 1.4;
/// Jerk of a frame over a fixed part, as a part of the 95th percentile of the motions that it is made
/// of, at most.
const OVER: f64 = 1.25;
/// Seconds before and after a key frame that count as around it.
const NEAR: f64 = 0.5;
/// Seconds beyond those in which smoothing falls off.
const FADE: f64 = 0.2;
/// Strength of the first smoothing, and how much stronger each next one is.
const FIRST: f64 = 0.05;
const STRONGER: f64 = 3.0;
/// Frames of the shortest motion that is smoothed.
const SHORTEST: usize = 8;
/// Most smoothings around a key frame, one after the other.
const MOST: usize = 14;
/// Most smoothings over fixed parts: what is calmed at one place moves to its edges, which are smoothed
/// from the first strength on.
const MOST_OVER: usize = 40;
/// The strongest smoothing there.
const STRONGEST: f64 = 1e6;
/// How often all key frames are gone through.
const ROUNDS: usize = 4;

/// Jerk of each frame from the third on: the mean length of the joints' third differences, in the
/// file's units, `[frames - 3]`.
pub fn jerks(bvh: &Bvh) -> Vec<f64> {
    let places = |t: usize| -> Vec<[f64; 3]> {
        let world = bvh.world(t).into_iter();
        world.map(|pose| pose.position).collect()
    };
    let places: Vec<Vec<[f64; 3]>> = (0..bvh.frames()).map(places).collect();
    let jerk = |four: &[Vec<[f64; 3]>]| {
        let joints = 0..four[0].len();
        let count = joints.len() as f64;
        let of = |joint: usize| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|t| four[t][joint]);
            length([0, 1, 2].map(|i| d[i] - 3.0 * c[i] + 3.0 * b[i] - a[i]))
        };
        joints.map(of).sum::<f64>() / count
    };
    places.windows(4).map(jerk).collect()
}

/// The value that 95 of 100 do not exceed; 0 of none.
pub fn percentile_95(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let index = (0.95 * sorted.len() as f64) as usize;
    sorted.get(index).copied().unwrap_or(0.0)
}

/// Mean jerk of the second around a frame, and elsewhere; 0 where there are no frames. `rate`: frames
/// a second.
pub fn jerk_around(jerks: &[f64], frame: f64, rate: f64) -> [f64; 2] {
    let near = |t: usize| (t as f64 + 1.5 - frame).abs() < NEAR * rate;
    [true, false].map(|wanted| {
        let all = jerks.iter().enumerate();
        let values = all.filter(|(t, _)| near(*t) == wanted);
        let (sum, count) = values.fold((0.0, 0), |(sum, count), (_, v)| (sum + v, count + 1));
        sum / f64::from(count.max(1))
    })
}

/// Smooths a motion around its key frames until its jerk there is at most 1.4 times that elsewhere,
/// or no smoothing helps. `around`: whether the last frame is followed by the first; then both sides of
/// that seam are smoothed alike. Otherwise the ends are free.
pub(crate) fn around_keyframes(
    layout: &MotionMatrix,
    frames: &mut Frames,
    constraints: &[Constraint],
    around: bool,
) -> Result<(), Error> {
    let n = frames.frames();
    if n < SHORTEST {
        return Ok(());
    }
    // What calms one may leave less of the rest for another to be measured by.
    for _ in 0..ROUNDS {
        if !around_each(layout, frames, constraints, around)? {
            break;
        }
    }
    Ok(())
}

/// Smooths a motion around each of its key frames in turn, and says whether anything was.
fn around_each(
    layout: &MotionMatrix,
    frames: &mut Frames,
    constraints: &[Constraint],
    around: bool,
) -> Result<bool, Error> {
    let n = frames.frames();
    let mut changed = false;
    for constraint in constraints {
        let Constraint::Keyframe { at, .. } = constraint else {
            continue;
        };
        let key = Constraint::frame(*at, n);
        if !around {
            changed |= around_one(layout, frames, constraints, key, false)?;
            continue;
        }
        // A loop is the same from any frame on: with the key frame in its middle it has no end there.
        let (middle, channels) = (n / 2, frames.channels());
        let shift = (key + n - middle) % n;
        let mut moved = constraints.to_vec();
        for constraint in &mut moved {
            if let Constraint::Keyframe { at, .. } = constraint {
                let t = (Constraint::frame(*at, n) + n - shift) % n;
                *at = (t as f64 + 0.5) / n as f64;
            }
        }
        frames.values_mut().rotate_left(shift * channels);
        let smoothed = around_one(layout, frames, &moved, middle, true);
        frames.values_mut().rotate_right(shift * channels);
        changed |= smoothed?;
    }
    Ok(changed)
}

/// Smooths a motion around the key frame at `key`, and says whether it was needed; `keep_ends`: whether
/// its ends stay as they are.
fn around_one(
    layout: &MotionMatrix,
    frames: &mut Frames,
    constraints: &[Constraint],
    key: usize,
    keep_ends: bool,
) -> Result<bool, Error> {
    let (n, key) = (frames.frames(), key as f64);
    let rate = 1.0 / layout.frame_time();
    let fade = |t: usize| {
        let beyond = (t as f64 + 1.5 - key).abs() - NEAR * rate;
        (1.0 - beyond / (FADE * rate)).clamp(0.0, 1.0).powi(3)
    };
    let voted = frames.clone();
    let mut strength = FIRST;
    let mut needed = false;
    for _ in 0..MOST {
        let [near, rest] = jerk_around(&jerks(&layout.to_bvh(frames)?), key, rate);
        if near <= AROUND * rest || rest == 0.0 {
            break;
        }
        let last = n - 4;
        let strengths = (0..n - 3).map(|t| match t {
            t if keep_ends && (t == 0 || t == last) => 0.0,
            t => strength * fade(t),
        });
        needed = true;
        *frames = voted.clone();
        smooth(frames, &strengths.collect::<Vec<_>>(), constraints);
        strength *= STRONGER;
    }
    Ok(needed)
}

/// Smooths what is free of a motion with fixed parts where its jerk is above 1.25 times `usual`,
/// the 95th percentile of the motions that it is made of. Joints that hang on a fixed one are smoothed
/// as they are in the world: a back that is steady within its hips trembles with them.
pub(crate) fn over_fixed_parts(
    layout: &MotionMatrix,
    frames: &mut Frames,
    constraints: &[Constraint],
    usual: f64,
) -> Result<(), Error> {
    if frames.frames() < SHORTEST {
        return Ok(());
    }
    let border = Border::of(layout, frames, constraints)?;
    let mut voted = frames.clone();
    border.to_world(&mut voted);
    let mut strengths = vec![0.0; frames.frames() - 3];
    for _ in 0..MOST_OVER {
        let jerks = jerks(&layout.to_bvh(frames)?);
        let above = |t: usize| jerks[t] > OVER * usual;
        let near = |t: usize| t.saturating_sub(3)..(t + 4).min(jerks.len());
        let reached = (0..jerks.len()).map(|t| near(t).any(above));
        let reached: Vec<bool> = reached.collect();
        if !reached.contains(&true) {
            break;
        }
        for (strength, _) in strengths.iter_mut().zip(reached).filter(|(_, is)| *is) {
            *strength = (STRONGER * *strength).clamp(FIRST, STRONGEST);
        }
        *frames = voted.clone();
        smooth(frames, &strengths, constraints);
        border.to_parents(frames);
    }
    Ok(())
}

/// The free joints that hang on fixed ones.
struct Border {
    /// First channel of each one's rotation, and how its parent is turned in the world, `[frames]`.
    joints: Vec<(usize, Vec<Quaternion>)>,
}

impl Border {
    fn of(
        layout: &MotionMatrix,
        frames: &Frames,
        constraints: &[Constraint],
    ) -> Result<Self, Error> {
        let is_fixed = |joint: usize| {
            let first = layout.rotation_of(joint).start;
            constraints.iter().any(|constraint| match constraint {
                Constraint::Channels { channels, .. } => channels.contains(&first),
                Constraint::Keyframe { .. } => false,
            })
        };
        let bvh = layout.to_bvh(frames)?;
        let world = (0..bvh.frames()).map(|t| bvh.world(t));
        let world: Vec<Vec<RootPose>> = world.collect();
        let joints = layout
            .joints()
            .iter()
            .enumerate()
            .filter_map(|(joint, own)| {
                let parent = own
                    .parent
                    .filter(|&parent| is_fixed(parent) && !is_fixed(joint))?;
                let turns = world.iter().map(|poses| poses[parent].orientation);
                Some((layout.rotation_of(joint).start, turns.collect()))
            });
        let joints = joints.collect();
        Ok(Self { joints })
    }

    /// Their rotations within their parents as those in the world.
    fn to_world(&self, frames: &mut Frames) {
        self.turn(frames, |parent| parent);
    }

    /// The way back.
    fn to_parents(&self, frames: &mut Frames) {
        self.turn(frames, Quaternion::conjugate);
    }

    fn turn(&self, frames: &mut Frames, by: impl Fn(Quaternion) -> Quaternion) {
        for (first, parents) in &self.joints {
            for (t, &parent) in parents.iter().enumerate() {
                let six = &mut frames.frame_mut(t)[*first..*first + 6];
                let own = std::array::from_fn(|i| f64::from(six[i]));
                let turned = by(parent) * rotation6d::to_quaternion(own);
                for (value, turned) in six.iter_mut().zip(rotation6d::from_quaternion(turned)) {
                    *value = turned as f32;
                }
            }
        }
    }
}
