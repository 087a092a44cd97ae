//! Locking of feet to the ground during contact, by two-bone inverse kinematics.
//!
//! Averaged, learned or edited motion lets feet slide. [`lock`] cancels the steps that a foot should
//! not make in contact, with a correction that is eased over its whole step. Hip and knee rotate to
//! follow; joints below the ankle move without rotation.
//!
//! [`ContactRule::contacts`] finds contacts; [`lock_joints`] does both for joints of a skeleton.

mod contacts;
mod ease;
mod locked_joints;

#[cfg(test)]
mod tests;

pub use contacts::{ContactRule, StepRule, runs, steps, without_short_runs};
pub use locked_joints::{LockedJoints, Planted, STEP_SECONDS, lock_joints};

use crate::Quaternion;
use crate::rotation::between;
use crate::vector::{length, minus, plus};
use ease::Foot;

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
    /// lifting the foot: its ground position gives way before its height, along axis `up`.
    fn reachable(&self, frame: &[[f64; 3]], by: [f64; 3], up: usize) -> [f64; 3] {
        let [_, longest] = self.reach(frame, SUPPLE);
        let now = minus(frame[self.ankle], frame[self.hip]);
        let mut place = plus(now, by);
        // A height that is out of reach stays as it was.
        if place[up].abs() >= longest {
            place[up] = now[up];
        }
        let height = place[up];
        let most = (longest * longest - height * height).max(0.0).sqrt();
        let ground = length(on_ground(place, up));
        let share = if ground > most { most / ground } else { 1.0 };
        place = place.map(|value| share * value);
        place[up] = height;
        minus(place, now)
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

/// Weight of contacts in which feet stand still.
pub const FIRM: f64 = 1e5;

/// Weight of contacts on paths that ask for longer steps than legs have: feet slip instead of snapping.
const SLIPPING: f64 = 1e3;

/// What feet do in contact.
#[derive(Clone, Copy, Debug)]
pub struct Standing<'a> {
    /// True in contact, `[legs][frames]`.
    pub contacts: &'a [Vec<bool>],
    /// The steps to the next frame that soles make in contact, `[legs][frames - 1]`.
    pub steps: &'a [Vec<[f64; 3]>],
    /// Frames over which a correction fades where no contact follows.
    pub fade: f64,
    /// Weight of the steps against the smoothness of the correction: [`FIRM`] if feet stand still.
    pub firmness: f64,
    /// The axis of heights.
    pub up: usize,
}

/// A motion with locked feet.
#[derive(Clone, Debug)]
pub struct Locked {
    /// Positions of the joints, `[frames][joints]`.
    pub positions: Vec<Vec<[f64; 3]>>,
    /// Rotations of the legs, `[legs][frames]`.
    pub turns: Vec<Vec<Turns>>,
    /// Largest distance of each sole from its place within a contact, `[legs]`.
    pub missed: Vec<f64>,
}

/// Locks every leg's sole in `positions`, `[frames][joints]`. `parents` precede their children. Legs
/// approach positions out of reach as far as possible, without lifting the foot.
pub fn lock(
    positions: &[Vec<[f64; 3]>],
    parents: &[Option<usize>],
    legs: &[Leg],
    standing: &Standing<'_>,
) -> Locked {
    let mut locked = positions.to_vec();
    let mut turns = Vec::with_capacity(legs.len());
    let mut missed = Vec::with_capacity(legs.len());
    let of_legs = standing.contacts.iter().zip(standing.steps);
    for (leg, (contacts, wanted)) in legs.iter().zip(of_legs) {
        assert_eq!(contacts.len(), positions.len(), "a contact for each frame");
        let made = positions
            .windows(2)
            .map(|pair| minus(pair[1][leg.sole], pair[0][leg.sole]));
        let foot = Foot {
            unwanted: made
                .zip(wanted)
                .map(|(made, wanted)| minus(made, *wanted))
                .collect(),
            contacts,
            firmness: standing.firmness,
            reachable: |t: usize, by| leg.reachable(&positions[t], by, standing.up),
        };
        let by = foot.corrections(standing.fade);
        missed.push(foot.missed(&by));
        let bent = locked.iter_mut().zip(by);
        turns.push(
            bent.map(|(frame, by)| bend(frame, parents, leg, by))
                .collect(),
        );
    }
    Locked {
        positions: locked,
        turns,
        missed,
    }
}

/// A vector without its height.
fn on_ground(mut vector: [f64; 3], up: usize) -> [f64; 3] {
    vector[up] = 0.0;
    vector
}

/// Mean step over the ground of a `path`, `[frames]`, between frames in contact; 0 without contacts.
/// `up`: the axis of heights.
pub fn sliding(path: &[[f64; 3]], contacts: &[bool], up: usize) -> f64 {
    let steps = path.windows(2).zip(contacts.windows(2));
    let steps = steps.filter(|(_, contacts)| contacts[0] && contacts[1]);
    let (sum, count) = steps.fold((0.0, 0), |(sum, count), (pair, _)| {
        let step = on_ground(minus(pair[1], pair[0]), up);
        (sum + length(step), count + 1)
    });
    sum / f64::from(count.max(1))
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
