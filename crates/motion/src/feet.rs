//! Feet that slide are held still while they touch the ground: two-bone inverse kinematics.
//!
//! Motions that are averaged, learned or cut together let feet slide. While a foot is in contact,
//! [`lock`] brings it to where it is on average during that contact; hip and knee follow, and
//! everything that hangs on the foot goes along without turning. Before and after a contact the
//! correction fades within a few frames.

use crate::Quaternion;
use crate::humanml::kinematics::{between, minus, plus};
use crate::rotation::length;

/// A leg is stretched to this part of its bones' length at most, so that the knee keeps its side.
const STRETCH: f64 = 0.9999;

/// A leg, by the indices of its joints.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Leg {
    /// The joint that the thigh turns about.
    pub hip: usize,
    /// The joint below, which the shin turns about.
    pub knee: usize,
    /// The joint below that, at the end of the shin.
    pub ankle: usize,
    /// The joint that stays still in contact: the ankle, or one that hangs on it, such as the toe.
    pub sole: usize,
}

impl Leg {
    /// The leg above an ankle. None if fewer than two joints are above it, or the sole hangs
    /// elsewhere.
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
}

/// Turns of a leg in one frame, in the world: what its joints' orientations are multiplied by from the
/// left. The ankle's orientation does not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turns {
    /// The thigh's.
    pub hip: Quaternion,
    /// The shin's.
    pub knee: Quaternion,
}

/// A motion whose feet are held.
#[derive(Clone, Debug)]
pub struct Locked {
    /// Where the joints are, `[frames][joints]`.
    pub positions: Vec<Vec<[f64; 3]>>,
    /// What turned, `[legs][frames]`.
    pub turns: Vec<Vec<Turns>>,
}

/// The motion `positions`, `[frames][joints]`, with every leg's sole held still wherever `contacts`,
/// `[legs][frames]`, says so; corrections fade within `blend` frames before and after. `parents`
/// come before their children. A place beyond a leg's reach is approached as far as it goes.
///
/// # Panics
/// Panics if the lists do not fit each other.
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
    for (leg, contacts) in legs.iter().zip(contacts) {
        assert_eq!(contacts.len(), positions.len(), "a contact for each frame");
        let path: Vec<[f64; 3]> = positions.iter().map(|frame| frame[leg.sole]).collect();
        let corrections = corrections(&path, contacts, blend);
        let bent = locked.iter_mut().zip(corrections);
        turns.push(
            bent.map(|(frame, by)| bend(frame, parents, leg, by))
                .collect(),
        );
    }
    Locked {
        positions: locked,
        turns,
    }
}

/// Mean distance that a joint moves per frame from one frame in contact to the next, as `path`,
/// `[frames]`, has it. Zero if there are no two such frames.
pub fn sliding(path: &[[f64; 3]], contacts: &[bool]) -> f64 {
    let steps = path.windows(2).zip(contacts.windows(2));
    let steps = steps.filter(|(_, contacts)| contacts[0] && contacts[1]);
    let (sum, count) = steps.fold((0.0, 0), |(sum, count), (pair, _)| {
        (sum + length(minus(pair[1], pair[0])), count + 1)
    });
    sum / f64::from(count.max(1))
}

/// What a path is moved by, `[frames]`: in a contact, to the mean place of that contact.
fn corrections(path: &[[f64; 3]], contacts: &[bool], blend: usize) -> Vec<[f64; 3]> {
    let frames = path.len();
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for (t, _) in contacts.iter().enumerate().filter(|(_, contact)| **contact) {
        match runs.last_mut() {
            Some(run) if run.1 == t => run.1 = t + 1,
            _ => runs.push((t, t + 1)),
        }
    }
    let mut by = vec![[0.0; 3]; frames];
    for (index, &(first, end)) in runs.iter().enumerate() {
        let sum = path[first..end]
            .iter()
            .fold([0.0; 3], |sum, &p| plus(sum, p));
        let still = sum.map(|value| value / (end - first) as f64);
        for t in first..end {
            by[t] = minus(still, path[t]);
        }
        // A fade ends before the next contact, which has a correction of its own.
        let before = index.checked_sub(1).map_or(0, |index| runs[index].1);
        let after = runs.get(index + 1).map_or(frames, |run| run.0);
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

/// 1 at a contact and 0 beyond the reach, flat at both.
fn fade(distance: usize, reach: usize) -> f64 {
    let part = distance as f64 / (reach + 1) as f64;
    1.0 - part * part * (3.0 - 2.0 * part)
}

/// Moves the ankle of a frame, and all that hangs on it, by `by`; thigh and shin keep their lengths.
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
    let shortest = (thigh - shin).abs() + (1.0 - STRETCH) * thigh.min(shin);
    let reached = distance.clamp(shortest, STRETCH * (thigh + shin));
    let along = wanted.map(|value| value / distance);
    // The whole leg towards its place, then the knee within the plane that it bends in.
    let aim = between(minus(ankle, hip), wanted);
    let thigh_aimed = aim.rotate(minus(knee, hip));
    let shin_aimed = aim.rotate(minus(ankle, knee));
    let x = (reached * reached + thigh * thigh - shin * shin) / (2.0 * reached);
    let y = (thigh * thigh - x * x).max(0.0).sqrt();
    let inner: f64 = (0..3).map(|axis| thigh_aimed[axis] * along[axis]).sum();
    let aside = minus(thigh_aimed, along.map(|value| inner * value));
    let bent = length(aside);
    if bent <= 1e-9 * thigh && y > 1e-6 * thigh {
        // A straight leg says nothing about the side of its knee.
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
    // What hangs on which of the three.
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

#[cfg(test)]
mod tests {
    use super::*;

    const PARENTS: [Option<usize>; 6] = [None, Some(0), Some(1), Some(2), Some(3), Some(1)];
    const LEG: Leg = Leg {
        hip: 1,
        knee: 2,
        ankle: 3,
        sole: 4,
    };

    /// A pelvis, a leg with a toe, and a pocket on the thigh, which slide along at a steady pace.
    fn sliding_leg(frames: usize) -> Vec<Vec<[f64; 3]>> {
        let at = |t: usize| {
            let x = 0.01 * t as f64;
            let leg = [
                [0.0, 1.0, 0.0],
                [0.1, 0.95, 0.0],
                [0.1, 0.5, 0.1],
                [0.1, 0.1, 0.0],
            ];
            let rest = [[0.1, 0.0, 0.15], [0.2, 0.7, 0.05]];
            let all = leg.into_iter().chain(rest);
            all.map(|[a, b, c]| [a + x, b, c]).collect()
        };
        (0..frames).map(at).collect()
    }

    #[test]
    fn a_leg_is_found_above_its_ankle() {
        assert_eq!(Leg::above(3, 4, &PARENTS), Some(LEG));
        assert_eq!(Leg::above(3, 5, &PARENTS), None);
        assert_eq!(Leg::above(1, 1, &PARENTS), None);
    }

    #[test]
    fn feet_stay_in_contact_and_bones_keep_their_lengths() {
        let motion = sliding_leg(40);
        let contacts: Vec<bool> = (0..40).map(|t| (10..20).contains(&t)).collect();
        let locked = lock(
            &motion,
            &PARENTS,
            &[LEG],
            std::slice::from_ref(&contacts),
            5,
        );
        let sole = |frames: &[Vec<[f64; 3]>]| -> Vec<[f64; 3]> {
            frames.iter().map(|frame| frame[4]).collect()
        };
        assert!((sliding(&sole(&motion), &contacts) - 0.01).abs() < 1e-12);
        assert!(sliding(&sole(&locked.positions), &contacts) < 1e-9);
        for (frame, old) in locked.positions.iter().zip(&motion) {
            for joint in 1..6 {
                let parent = PARENTS[joint].unwrap();
                let bone = |frame: &[[f64; 3]]| length(minus(frame[joint], frame[parent]));
                assert!((bone(frame) - bone(old)).abs() < 1e-9);
            }
            assert_eq!(frame[..2], old[..2]);
        }
        // Nothing jumps, and nothing is left of it five frames away.
        let path = sole(&locked.positions);
        assert!(
            path.windows(2)
                .all(|pair| length(minus(pair[1], pair[0])) < 0.03)
        );
        assert_eq!(
            (locked.positions[4][4], locked.positions[25][4]),
            (motion[4][4], motion[25][4])
        );
    }

    #[test]
    fn turns_lead_to_the_same_places() {
        let motion = sliding_leg(12);
        let locked = lock(&motion, &PARENTS, &[LEG], &[vec![true; 12]], 3);
        for ((frame, old), turns) in locked.positions.iter().zip(&motion).zip(&locked.turns[0]) {
            let knee = plus(old[1], turns.hip.rotate(minus(old[2], old[1])));
            let ankle = plus(knee, turns.knee.rotate(minus(old[3], old[2])));
            let toe = plus(ankle, minus(old[4], old[3]));
            for (found, place) in [(knee, frame[2]), (ankle, frame[3]), (toe, frame[4])] {
                assert!(length(minus(found, place)) < 1e-9);
            }
        }
    }

    #[test]
    fn contacts_close_to_each_other_are_held_each_in_its_place() {
        let motion = sliding_leg(20);
        let contacts: Vec<bool> = (0..20).map(|t| t != 9 && t != 10).collect();
        let locked = lock(
            &motion,
            &PARENTS,
            &[LEG],
            std::slice::from_ref(&contacts),
            6,
        );
        let path: Vec<_> = locked.positions.iter().map(|frame| frame[4]).collect();
        assert!(sliding(&path, &contacts) < 1e-9);
        assert!(path[11][0] - path[8][0] > 0.05);
    }

    #[test]
    fn a_place_out_of_reach_is_approached() {
        let mut motion = sliding_leg(2);
        motion[1].iter_mut().for_each(|place| place[0] += 3.0);
        let locked = lock(&motion, &PARENTS, &[LEG], &[vec![true; 2]], 3);
        let finite = locked.positions.iter().flatten().flatten();
        assert!(finite.copied().all(f64::is_finite));
        let leg = minus(locked.positions[0][3], locked.positions[0][1]);
        assert!(leg[0] > 0.7 && length(leg) < 0.9);
    }
}
