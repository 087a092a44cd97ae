//! Limits jerk at constraints to the jerk of the rest of the motion.
//!
//! Motion around key frames and next to fixed parts is smoothed as much as needed; constraints stay
//! exact.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::length;

use crate::smoothing::smooth;
use crate::{Constraint, Error, Frames, MotionMatrix, rotation6d};

/// Largest mean jerk of the second around a key frame, relative to the rest.
const AROUND: f64 = 1.4;
/// Largest jerk of a frame over a fixed part, relative to the 95th percentile of the source
/// motions.
const OVER: f64 = 1.25;
/// Half width of the surroundings of a key frame, in seconds.
const NEAR: f64 = 0.5;
/// Seconds beyond [`NEAR`] over which smoothing falls off.
const FADE: f64 = 0.2;
/// First strength of smoothing, and the factor between successive strengths.
const FIRST: f64 = 0.05;
const STRONGER: f64 = 3.0;
/// Frames of the shortest motion that is smoothed.
const SHORTEST: usize = 8;
/// Most strengths tried around a key frame.
const MOST: usize = 14;
/// Most iterations over fixed parts: jerk moves to the edges of smoothed stretches, which are
/// smoothed in turn.
const MOST_OVER: usize = 40;
/// Largest strength over fixed parts.
const STRONGEST: f64 = 1e6;
/// Most passes over all key frames.
const ROUNDS: usize = 4;

/// Jerk of each frame from the third on: the mean length of the joints' third differences, in file
/// units, `[frames - 3]`.
pub fn jerks(bvh: &Bvh) -> Vec<f64> {
    let world: Vec<Vec<RootPose>> = (0..bvh.frames()).map(|t| bvh.world(t)).collect();
    let jerk = |four: &[Vec<RootPose>]| {
        let joints = four[0].len();
        let all = (0..joints).map(|joint| third_difference(four, joint));
        all.sum::<f64>() / joints as f64
    };
    world.windows(4).map(jerk).collect()
}

/// Length of the third difference of a joint's position over four frames, in file units.
pub(crate) fn third_difference(four: &[Vec<RootPose>], joint: usize) -> f64 {
    let [a, b, c, d] = [0, 1, 2, 3].map(|t| four[t][joint].position);
    length([0, 1, 2].map(|i| d[i] - 3.0 * c[i] + 3.0 * b[i] - a[i]))
}

/// The 95th percentile; 0 of no values.
pub fn percentile_95(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let index = (0.95 * sorted.len() as f64) as usize;
    sorted.get(index).copied().unwrap_or(0.0)
}

/// Mean jerk within half a second of a frame, and elsewhere; 0 without frames. `rate`: frames a
/// second.
pub fn jerk_around(jerks: &[f64], frame: f64, rate: f64) -> [f64; 2] {
    let near = |t: usize| (t as f64 + 1.5 - frame).abs() < NEAR * rate;
    [true, false].map(|wanted| {
        let all = jerks.iter().enumerate();
        let values = all.filter(|(t, _)| near(*t) == wanted);
        let (sum, count) = values.fold((0.0, 0), |(sum, count), (_, v)| (sum + v, count + 1));
        sum / f64::from(count.max(1))
    })
}

/// Smooths a motion around its key frames until the jerk there is at most 1.4 times the jerk
/// elsewhere. `is_loop`: both sides of the seam are smoothed alike; otherwise the ends are free.
pub(crate) fn around_keyframes(
    layout: &MotionMatrix,
    frames: &mut Frames,
    constraints: &[Constraint],
    is_loop: bool,
) -> Result<(), Error> {
    let n = frames.frames();
    if n < SHORTEST {
        return Ok(());
    }
    // Smoothing one key frame lowers the reference of the others.
    for _ in 0..ROUNDS {
        let mut changed = false;
        for constraint in constraints {
            let Constraint::Keyframe { at, .. } = constraint else {
                continue;
            };
            let key = Constraint::frame(*at, n);
            if !is_loop {
                changed |= around_one(layout, frames, constraints, key, false)?;
                continue;
            }
            // A loop can be rotated: with the key frame in its middle, both ends are far away.
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
        if !changed {
            break;
        }
    }
    Ok(())
}

/// Smooths around the key frame `key`; returns true if smoothing was needed. `keep_ends`: the ends
/// do not change.
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

/// Smooths the free channels of a motion with fixed parts where the jerk is above 1.25 times
/// `usual`, the 95th percentile of the source motions. Joints below a fixed joint are smoothed in
/// world coordinates: a back that is still relative to shaking hips shakes too.
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
    // Converts to world rotations; the inverse follows below.
    border.turn(&mut voted, |parent| parent);
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
        border.turn(frames, Quaternion::conjugate);
    }
    Ok(())
}

/// The free joints whose parents are fixed.
struct Border {
    /// First rotation channel and the parent's world rotation, `[frames]`.
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
        let world: Vec<Vec<RootPose>> = (0..bvh.frames()).map(|t| bvh.world(t)).collect();
        let joints = layout.joints().iter().enumerate();
        let joints = joints.filter_map(|(joint, own)| {
            let parent = own.parent.filter(|&p| is_fixed(p) && !is_fixed(joint))?;
            let turns = world.iter().map(|poses| poses[parent].orientation);
            Some((layout.rotation_of(joint).start, turns.collect()))
        });
        Ok(Self {
            joints: joints.collect(),
        })
    }

    /// Rotates the joints by the parents' rotations, each transformed with `by`.
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
