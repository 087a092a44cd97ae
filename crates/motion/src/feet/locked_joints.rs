//! The feet of a skeleton's joints.

use super::{ContactRule, Leg, lock, sliding};
use crate::humanml::{FeatureError, Joints, Skeleton};

/// Seconds over which a correction fades: five frames at 20 frames per second.
const BLEND_SECONDS: f64 = 0.25;

/// Joints whose feet are locked in contact.
#[derive(Clone, Debug)]
pub struct LockedJoints {
    /// The joints.
    pub joints: Joints,
    /// Share of the frames in contact, of all feet.
    pub in_contact: f64,
    /// Mean speed of feet in contact before locking, metres per second.
    pub before: f64,
    /// Mean speed of feet in contact after locking.
    pub after: f64,
    /// Largest distance of a foot from its contact position if the leg is too short, metres.
    pub missed: f64,
}

/// Locks the feet of `joints` during the contacts above `floor` that `rule` finds in `seen`, the
/// joints or their source.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] unless both are the same frames of joints of `skeleton`.
pub fn lock_joints(
    joints: &Joints,
    seen: &Joints,
    skeleton: &Skeleton,
    rule: &ContactRule,
    floor: f64,
) -> Result<LockedJoints, FeatureError> {
    joints.must_be_of(skeleton)?;
    seen.must_be_of(skeleton)?;
    FeatureError::unless_equal("frames", joints.frames(), seen.frames())?;
    let fps = skeleton.description().fps;
    let legs = skeleton.legs();
    let stands = |leg: &Leg| rule.contacts(&seen.track(leg.sole), fps, floor);
    let contacts: Vec<Vec<bool>> = legs.iter().map(stands).collect();
    let frames = (0..joints.frames()).map(|t| joints.frame(t).to_vec());
    let frames: Vec<Vec<[f64; 3]>> = frames.collect();
    let blend = (BLEND_SECONDS * fps).round() as usize;
    let locked = lock(&frames, skeleton.parents(), &legs, &contacts, blend);
    let joints_after = Joints::new(locked.positions.concat(), joints.joints())?;
    let speed = |joints: &Joints| {
        let of =
            |(leg, contacts): (&Leg, &Vec<bool>)| sliding(&joints.track(leg.sole), contacts) * fps;
        legs.iter().zip(&contacts).map(of).sum::<f64>() / legs.len().max(1) as f64
    };
    let flags = contacts.concat();
    let standing = flags.iter().filter(|&&contact| contact).count();
    let missed = locked.missed.concat().into_iter().fold(0.0, f64::max);
    Ok(LockedJoints {
        in_contact: standing as f64 / flags.len().max(1) as f64,
        before: speed(joints),
        after: speed(&joints_after),
        missed,
        joints: joints_after,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk::{Course, joints as walk};
    use crate::metrics::skating_ratio;
    use crate::vector::{length, minus};

    /// A walk whose joints slide by `slide` metres per second, and to the left. With a backward
    /// slide the strides are longer than the path, so the legs reach every contact position.
    fn sliding_walk(skeleton: &Skeleton, slide: f64) -> Joints {
        let course = Course {
            speed: Box::new(|_| 1.1),
            turning: Box::new(|t| 0.4 * (1.3 * t).sin()),
        };
        let places = walk(&course, skeleton, 70);
        let places = places.chunks(22).enumerate().flat_map(|(t, frame)| {
            let by = slide * t as f64 / 20.0;
            frame
                .iter()
                .map(move |[x, y, z]| [x + 0.5 * by, *y, z + by])
        });
        Joints::new(places.collect(), 22).unwrap()
    }

    #[test]
    fn legs_are_those_of_the_published_skeletons() {
        let leg = |hip, knee, ankle, sole| Leg {
            hip,
            knee,
            ankle,
            sole,
        };
        let legs = Skeleton::humanml3d().legs();
        assert_eq!(legs, [leg(1, 4, 7, 10), leg(2, 5, 8, 11)]);
        let legs = Skeleton::kit().legs();
        assert_eq!(legs, [leg(16, 17, 18, 20), leg(11, 12, 13, 15)]);
    }

    #[test]
    fn a_walk_that_slides_stands_still_in_contact() {
        let skeleton = Skeleton::humanml3d();
        let rule = ContactRule::default();
        let slid = sliding_walk(&skeleton, -0.4);
        let locked = lock_joints(&slid, &slid, &skeleton, &rule, 0.0).unwrap();
        assert!(
            locked.in_contact > 0.4 && locked.in_contact < 0.8,
            "{}",
            locked.in_contact
        );
        assert!(locked.before > 0.3, "{}", locked.before);
        assert!(
            locked.after < 1e-6 && locked.missed < 1e-9,
            "{} {}",
            locked.after,
            locked.missed
        );
        // During a contact, a sole stays within a millimetre of one place.
        let fps = skeleton.description().fps;
        let mut places = 0;
        for leg in skeleton.legs() {
            let contacts = rule.contacts(&slid.track(leg.sole), fps, 0.0);
            let path = locked.joints.track(leg.sole);
            for run in super::super::runs(&contacts) {
                places += 1;
                let first = path[run.start];
                let moved = path[run.clone()].iter().map(|p| length(minus(*p, first)));
                assert!(moved.fold(0.0, f64::max) < 1e-3);
            }
        }
        assert!(places >= 4, "{places}");
        // Bones keep their lengths, and joints above the legs their positions.
        for t in 0..slid.frames() {
            let (old, new) = (slid.frame(t), locked.joints.frame(t));
            for (joint, parent) in skeleton.parents().iter().enumerate() {
                let Some(parent) = *parent else { continue };
                let bone = |frame: &[[f64; 3]]| length(minus(frame[joint], frame[parent]));
                assert!((bone(old) - bone(new)).abs() < 1e-5);
            }
            for joint in [0, 1, 2, 3, 9, 15, 21] {
                assert_eq!(old[joint], new[joint]);
            }
        }
        // No joint jumps: a foot moves per frame by the swing's 15 cm and the fading correction.
        let largest = |joints: &Joints| {
            let pairs = (1..joints.frames()).flat_map(|t| {
                let pairs = joints.frame(t).iter().zip(joints.frame(t - 1));
                pairs
                    .map(|(a, b)| length(minus(*a, *b)))
                    .collect::<Vec<_>>()
            });
            pairs.fold(0.0, f64::max)
        };
        assert!(
            largest(&locked.joints) < largest(&slid) + 0.08,
            "{} {}",
            largest(&locked.joints),
            largest(&slid)
        );
        let skates = |joints: &Joints| skating_ratio(joints, fps, &[10, 11]).unwrap();
        let quick = sliding_walk(&skeleton, -0.48);
        let quick_held = lock_joints(&quick, &quick, &skeleton, &rule, 0.0).unwrap();
        // A foot that has just lifted is low and quick, also in a walk without sliding.
        let own = skates(&sliding_walk(&skeleton, 0.0));
        let (before, after) = (skates(&quick), skates(&quick_held.joints));
        assert!(before > 0.9 && after < own + 0.05, "{before} {after} {own}");
    }

    #[test]
    fn legs_that_are_too_short_are_stretched_and_reported() {
        // The body slides further than its strides reach.
        let skeleton = Skeleton::humanml3d();
        let slid = sliding_walk(&skeleton, 0.4);
        let locked = lock_joints(&slid, &slid, &skeleton, &ContactRule::default(), 0.0).unwrap();
        assert!(locked.missed > 0.02, "{}", locked.missed);
        assert!(locked.after < 0.6 * locked.before, "{}", locked.after);
        for leg in skeleton.legs() {
            for t in 0..slid.frames() {
                let bone = |joints: &Joints, [a, b]: [usize; 2]| {
                    length(minus(joints.frame(t)[a], joints.frame(t)[b]))
                };
                for ends in [
                    [leg.hip, leg.knee],
                    [leg.knee, leg.ankle],
                    [leg.ankle, leg.sole],
                ] {
                    assert!((bone(&slid, ends) - bone(&locked.joints, ends)).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn a_body_that_never_stands_is_left_as_it_is() {
        let skeleton = Skeleton::humanml3d();
        let walk = sliding_walk(&skeleton, -0.4);
        let above = walk.as_slice().iter().map(|[x, y, z]| [*x, y + 0.3, *z]);
        let flying = Joints::new(above.collect(), 22).unwrap();
        let rule = ContactRule::default();
        let locked = lock_joints(&flying, &flying, &skeleton, &rule, 0.0).unwrap();
        assert_eq!(locked.joints, flying);
        // On a floor at that height the body stands as often as in the original walk.
        let on_floor = lock_joints(&flying, &flying, &skeleton, &rule, 0.3).unwrap();
        let own = lock_joints(&walk, &walk, &skeleton, &rule, 0.0).unwrap();
        assert!(own.in_contact > 0.1 && on_floor.in_contact == own.in_contact);
        assert_eq!(
            (locked.in_contact, locked.before, locked.missed),
            (0.0, 0.0, 0.0)
        );
        // The contacts are those of the other joints.
        let locked = lock_joints(&flying, &walk, &skeleton, &ContactRule::default(), 0.0).unwrap();
        assert!(locked.after < 1e-6 && locked.joints != flying);
        let short = Joints::new(walk.as_slice()[..22].to_vec(), 22).unwrap();
        assert!(lock_joints(&walk, &short, &skeleton, &ContactRule::default(), 0.0).is_err());
        assert!(lock_joints(&walk, &walk, &Skeleton::kit(), &ContactRule::default(), 0.0).is_err());
    }
}
