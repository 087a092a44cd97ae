//! Locking of feet to the ground during contact, by two-bone inverse kinematics.
//!
//! Averaged, learned or edited motion lets feet slide. [`lock`] moves a foot in contact to its mean
//! position during that contact. Hip and knee rotate to follow; joints below the ankle move without
//! rotation. Before and after a contact the correction fades within a few frames.
//!
//! [`ContactRule::contacts`] finds contacts; [`lock_joints`] does both for joints of a skeleton.

mod contacts;
mod ease;
mod locked_joints;

#[cfg(test)]
mod tests;

pub use contacts::{ContactRule, StepRule, runs, steps, without_short_runs};
pub use locked_joints::{LockedJoints, Planted, lock_joints};

use std::ops::Range;

use crate::Quaternion;
use crate::rotation::between;
use crate::vector::{length, minus, plus};

/// Largest length of a bent leg as a share of its bones, so that the knee keeps its side.
/// Straighter legs stay straight.
const STRETCH: f64 = 0.9999;

/// Longest leg of an eased correction as a share of its bones: straighter knees snap.
const SUPPLE: f64 = 0.995;

/// With the knee nearer to the leg's line than this share of the thigh, the sole decides its side.
const STRAIGHT: f64 = 0.1;

/// A leg, by the indices of its joints.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Leg {
    /// Parent joint of the thigh.
    pub hip: usize,
    /// Joint between thigh and shin.
    pub knee: usize,
    /// Joint at the end of the shin.
    pub ankle: usize,
    /// The joint that is locked in contact: the ankle or a joint below, such as the toe.
    pub sole: usize,
}

impl Leg {
    /// The leg above an ankle; `None` without two parents, or if the sole is not below the ankle.
    pub fn above(ankle: usize, sole: usize, parents: &[Option<usize>]) -> Option<Self> {
        let knee = parents[ankle]?;
        let hip = parents[knee]?;
        let mut above = std::iter::successors(Some(sole), |&joint| parents[joint]);
        above.any(|joint| joint == ankle).then_some(Self {
            hip,
            knee,
            ankle,
            sole,
        })
    }

    /// Shortest and longest distance of the ankle from the hip with bones as in `frame`; a leg that
    /// is longer than `stretch` of its bones may stay so.
    fn reach(&self, frame: &[[f64; 3]], stretch: f64) -> [f64; 2] {
        let bone = |a: usize, b: usize| length(minus(frame[a], frame[b]));
        let (thigh, shin) = (bone(self.hip, self.knee), bone(self.knee, self.ankle));
        let longest = (stretch * (thigh + shin)).max(bone(self.hip, self.ankle));
        let shortest = (thigh - shin).abs() + (1.0 - STRETCH) * thigh.min(shin);
        [shortest.min(longest), longest]
    }

    /// The nearest correction of the sole's position in `frame` that the leg reaches without
    /// lifting the foot: its ground position gives way before its height (+y up).
    fn reachable(&self, frame: &[[f64; 3]], by: [f64; 3]) -> [f64; 3] {
        let [_, longest] = self.reach(frame, SUPPLE);
        let now = minus(frame[self.ankle], frame[self.hip]);
        let [x, y, z] = plus(now, by);
        // A height that is out of reach stays as it was.
        let y = if y.abs() < longest { y } else { now[1] };
        let (ground, most) = (x.hypot(z), (longest * longest - y * y).max(0.0).sqrt());
        let share = if ground > most { most / ground } else { 1.0 };
        minus([share * x, y, share * z], now)
    }
}

/// Rotations of a leg in one frame, in world coordinates, applied from the left. The ankle keeps
/// its orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turns {
    /// The thigh's.
    pub hip: Quaternion,
    /// The shin's.
    pub knee: Quaternion,
}

/// A motion with locked feet.
#[derive(Clone, Debug)]
pub struct Locked {
    /// Positions of the joints, `[frames][joints]`.
    pub positions: Vec<Vec<[f64; 3]>>,
    /// Rotations of the legs, `[legs][frames]`.
    pub turns: Vec<Vec<Turns>>,
    /// Distance of each sole from a contact position out of reach, `[legs][frames]`.
    pub missed: Vec<Vec<f64>>,
}

/// Locks every leg's sole in `positions`, `[frames][joints]`, during `contacts`, `[legs][frames]`.
/// Corrections fade within `blend` frames before and after. `parents` precede their children. Legs
/// approach positions out of reach as far as possible.
pub fn lock(
    positions: &[Vec<[f64; 3]>],
    parents: &[Option<usize>],
    legs: &[Leg],
    contacts: &[Vec<bool>],
    blend: usize,
) -> Locked {
    assert_eq!(legs.len(), contacts.len(), "contacts of each leg");
    let mut locked = positions.to_vec();
    let mut turns = Vec::with_capacity(legs.len());
    let mut missed = Vec::with_capacity(legs.len());
    for (leg, contacts) in legs.iter().zip(contacts) {
        assert_eq!(contacts.len(), positions.len(), "a contact for each frame");
        let path: Vec<[f64; 3]> = positions.iter().map(|frame| frame[leg.sole]).collect();
        let corrections = corrections(&path, contacts, blend);
        let bent = locked.iter_mut().zip(path).zip(corrections);
        let bent = bent.map(|((frame, place), by)| {
            let turns = bend(frame, parents, leg, by);
            let left = minus(plus(place, by), frame[leg.sole]);
            (turns, length(left))
        });
        let (of_leg, left) = bent.unzip();
        turns.push(of_leg);
        missed.push(left);
    }
    Locked {
        positions: locked,
        turns,
        missed,
    }
}

/// Mean step of a `path`, `[frames]`, between frames in contact; 0 without contacts.
pub fn sliding(path: &[[f64; 3]], contacts: &[bool]) -> f64 {
    let steps = path.windows(2).zip(contacts.windows(2));
    let steps = steps.filter(|(_, contacts)| contacts[0] && contacts[1]);
    let (sum, count) = steps.fold((0.0, 0), |(sum, count), (pair, _)| {
        (sum + length(minus(pair[1], pair[0])), count + 1)
    });
    sum / f64::from(count.max(1))
}

/// Corrections of a path, `[frames]`, to the mean position of each contact.
fn corrections(path: &[[f64; 3]], contacts: &[bool], blend: usize) -> Vec<[f64; 3]> {
    let frames = path.len();
    let runs = runs(contacts);
    let mut by = vec![[0.0; 3]; frames];
    for (index, &Range { start: first, end }) in runs.iter().enumerate() {
        let contact = path[first..end].iter();
        let sum = contact.fold([0.0; 3], |sum, &p| plus(sum, p));
        let still = sum.map(|value| value / (end - first) as f64);
        for t in first..end {
            by[t] = minus(still, path[t]);
        }
        // A fade ends before the next contact.
        let before = index.checked_sub(1).map_or(0, |index| runs[index].end);
        let after = runs.get(index + 1).map_or(frames, |run| run.start);
        let (reach, edge) = (blend.min(first - before), minus(still, path[first]));
        for (back, by) in by[first - reach..first].iter_mut().rev().enumerate() {
            let weight = fade(back + 1, reach);
            *by = plus(*by, edge.map(|value| weight * value));
        }
        let (reach, edge) = (blend.min(after - end), minus(still, path[end - 1]));
        for (on, by) in by[end..end + reach].iter_mut().enumerate() {
            let weight = fade(on + 1, reach);
            *by = plus(*by, edge.map(|value| weight * value));
        }
    }
    by
}

/// The fade: 1 at a contact, 0 beyond the reach, smooth at both.
fn fade(distance: usize, reach: usize) -> f64 {
    let part = distance as f64 / (reach + 1) as f64;
    1.0 - part * part * (3.0 - 2.0 * part)
}

/// Moves the ankle and all joints below by `by` in one frame; bones keep their lengths.
fn bend(frame: &mut [[f64; 3]], parents: &[Option<usize>], leg: &Leg, by: [f64; 3]) -> Turns {
    let [hip, knee, ankle] = [leg.hip, leg.knee, leg.ankle].map(|joint| frame[joint]);
    let still = Turns {
        hip: Quaternion::IDENTITY,
        knee: Quaternion::IDENTITY,
    };
    let (thigh, shin) = (length(minus(knee, hip)), length(minus(ankle, knee)));
    let wanted = minus(plus(ankle, by), hip);
    let distance = length(wanted);
    if by == [0.0; 3] || thigh == 0.0 || shin == 0.0 || distance == 0.0 {
        return still;
    }
    let [shortest, longest] = leg.reach(frame, STRETCH);
    let reached = distance.clamp(shortest, longest);
    let along = wanted.map(|value| value / distance);
    let across = |vector: [f64; 3]| {
        let inner: f64 = (0..3).map(|axis| vector[axis] * along[axis]).sum();
        minus(vector, along.map(|value| inner * value))
    };
    // The whole leg is rotated first, then the knee within the leg's plane.
    let aim = between(minus(ankle, hip), wanted);
    let thigh_aimed = aim.rotate(minus(knee, hip));
    let shin_aimed = aim.rotate(minus(ankle, knee));
    let x = (reached * reached + thigh * thigh - shin * shin) / (2.0 * reached);
    let y = (thigh * thigh - x * x).max(0.0).sqrt();
    let mut aside = across(thigh_aimed);
    let (bent, limit) = (length(aside), STRAIGHT * thigh);
    if bent < limit {
        let toes = across(minus(frame[leg.sole], ankle));
        let weight = (limit - bent) / length(toes).max(1e-9);
        aside = plus(aside, toes.map(|value| weight * value));
    }
    let bent = length(aside);
    if bent <= 1e-9 * thigh && y > 1e-6 * thigh {
        // Neither knee nor sole determines a side.
        return still;
    }
    let aside = aside.map(|value| value / bent.max(f64::MIN_POSITIVE));
    let new_thigh = [0, 1, 2].map(|axis| x * along[axis] + y * aside[axis]);
    let new_ankle = along.map(|value| reached * value);
    let new_shin = minus(new_ankle, new_thigh);
    let turns = Turns {
        hip: between(thigh_aimed, new_thigh) * aim,
        knee: between(shin_aimed, new_shin) * aim,
    };
    // The part of the leg that each joint belongs to.
    let mut carried: Vec<Option<usize>> = vec![None; frame.len()];
    let old: Vec<[f64; 3]> = frame.to_vec();
    for joint in 0..frame.len() {
        carried[joint] = match joint {
            _ if [leg.hip, leg.knee, leg.ankle].contains(&joint) => Some(joint),
            _ => parents[joint].and_then(|parent| carried[parent]),
        };
        let turned = |about: usize, turn: Quaternion, to: [f64; 3]| {
            plus(to, turn.rotate(minus(old[joint], old[about])))
        };
        frame[joint] = match carried[joint] {
            Some(part) if part == leg.hip => turned(leg.hip, turns.hip, hip),
            Some(part) if part == leg.knee => turned(leg.knee, turns.knee, plus(hip, new_thigh)),
            Some(_) => turned(leg.ankle, Quaternion::IDENTITY, plus(hip, new_ankle)),
            None => old[joint],
        };
    }
    turns
}
