//! The feet of a skeleton's joints.

use super::{ContactRule, FIRM, Leg, SLIPPING, Standing, lock, sliding};
use crate::humanml::{FeatureError, Joints, Skeleton};
use crate::metrics::SKATING_SPEED;
use crate::vector::minus;

/// Seconds over which a correction fades where no contact follows: about a step.
pub const STEP_SECONDS: f64 = 0.4;

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

/// What a planted foot does.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Planted {
    /// It stays in its place on the ground, unless it is about to leave the contact.
    Still,
    /// It moves over the ground as in the motion in which contacts are found; slow steps are left
    /// out.
    AsSeen,
}

/// Locks the feet of `joints` where `rule` finds contacts above `floor` in `seen`, the joints
/// themselves or their source. Heights change as those of `seen`: a foot out of reach slides.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] unless both are the same frames of joints of `skeleton`.
pub fn lock_joints(
    joints: &Joints,
    seen: &Joints,
    skeleton: &Skeleton,
    rule: &ContactRule,
    planted: Planted,
    floor: f64,
) -> Result<LockedJoints, FeatureError> {
    joints.must_be_of(skeleton)?;
    seen.must_be_of(skeleton)?;
    FeatureError::unless_equal("frames", joints.frames(), seen.frames())?;
    let fps = skeleton.description().fps;
    let legs = skeleton.legs();
    let turns: Vec<f64> = (0..joints.frames())
        .map(|t| turn(seen.frame(t), joints.frame(t)))
        .collect();
    let contacts: Vec<Vec<bool>> = (legs.iter())
        .map(|leg| rule.contacts(&seen.track(leg.sole), fps, floor))
        .collect();
    let (quick, firmness) = match planted {
        Planted::Still => (rule.lasting * rule.speed, FIRM),
        Planted::AsSeen => (SKATING_SPEED, SLIPPING),
    };
    // A step of the source, turned as the body is and without slow sliding.
    let step = |sole: usize, t: usize| {
        let [x, y, z] = minus(seen.frame(t + 1)[sole], seen.frame(t)[sole]);
        let share = (2.0 * x.hypot(z) * fps / quick - 1.0).clamp(0.0, 1.0);
        let (sin, cos) = (0.5 * (turns[t] + turns[t + 1])).sin_cos();
        [share * (x * cos + z * sin), y, share * (z * cos - x * sin)]
    };
    let of_leg = |leg: &Leg| {
        (0..joints.frames() - 1)
            .map(|t| step(leg.sole, t))
            .collect()
    };
    let standing = Standing {
        contacts: &contacts,
        steps: &legs.iter().map(of_leg).collect::<Vec<_>>(),
        fade: STEP_SECONDS * fps,
        firmness,
        up: 1,
    };
    let frames = (0..joints.frames()).map(|t| joints.frame(t).to_vec());
    let frames: Vec<Vec<[f64; 3]>> = frames.collect();
    let locked = lock(&frames, skeleton.parents(), &legs, &standing);
    let speed = |frames: &[Vec<[f64; 3]>]| {
        let of = |(leg, contacts): (&Leg, &Vec<bool>)| {
            let path: Vec<[f64; 3]> = frames.iter().map(|frame| frame[leg.sole]).collect();
            sliding(&path, contacts, standing.up) * fps
        };
        legs.iter().zip(&contacts).map(of).sum::<f64>() / legs.len().max(1) as f64
    };
    let in_contact = contacts
        .iter()
        .flatten()
        .filter(|contact| **contact)
        .count();
    Ok(LockedJoints {
        in_contact: in_contact as f64 / (legs.len() * joints.frames()).max(1) as f64,
        before: speed(&frames),
        after: speed(&locked.positions),
        missed: locked.missed.iter().copied().fold(0.0, f64::max),
        joints: Joints::new(locked.positions.concat(), joints.joints())?,
    })
}

/// Rotation about +y that turns the ground positions of `from` about their root best into those of
/// `to`, radians.
fn turn(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    let pairs = from
        .iter()
        .zip(to)
        .map(|(a, b)| (minus(*a, from[0]), minus(*b, to[0])));
    let (sin, cos) = pairs.fold((0.0, 0.0), |(sin, cos), ([ax, _, az], [bx, _, bz])| {
        (sin + az * bx - ax * bz, cos + ax * bx + az * bz)
    });
    sin.atan2(cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk::{Course, joints as walk};
    use crate::metrics::{BodyQuality, skating_ratio};
    use crate::vector::length;

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
        let locked = lock_joints(&slid, &slid, &skeleton, &rule, Planted::Still, 0.0).unwrap();
        assert!(
            locked.in_contact > 0.4 && locked.in_contact < 0.8,
            "{}",
            locked.in_contact
        );
        assert!(locked.before > 0.3, "{}", locked.before);
        assert!(
            locked.after < 0.02 * locked.before && locked.missed < 0.02,
            "{} {}",
            locked.after,
            locked.missed
        );
        // During a contact, a sole stays within two centimetres of one place on the ground.
        let fps = skeleton.description().fps;
        let mut places = 0;
        for leg in skeleton.legs() {
            let contacts = rule.contacts(&slid.track(leg.sole), fps, 0.0);
            let path = locked.joints.track(leg.sole);
            for run in super::super::runs(&contacts) {
                places += 1;
                let first = path[run.start];
                let moved = path[run.clone()].iter().map(|p| {
                    let [x, _, z] = minus(*p, first);
                    x.hypot(z)
                });
                assert!(moved.fold(0.0, f64::max) < 0.02);
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
        let quick_held =
            lock_joints(&quick, &quick, &skeleton, &rule, Planted::Still, 0.0).unwrap();
        // A foot that has just left is low and quick: what a walk that does not slide has as well.
        let own = skates(&sliding_walk(&skeleton, 0.0));
        let (before, after) = (skates(&quick), skates(&quick_held.joints));
        assert!(before > 0.9 && after < own + 0.05, "{before} {after} {own}");
    }

    #[test]
    fn still_feet_do_not_snap() {
        let skeleton = Skeleton::humanml3d();
        for slide in [-0.3, -0.15, 0.0, 0.1] {
            let slid = sliding_walk(&skeleton, slide);
            let rule = ContactRule::default();
            let locked = lock_joints(&slid, &slid, &skeleton, &rule, Planted::Still, 0.0).unwrap();
            let [before, after] = [&slid, &locked.joints].map(|joints| {
                BodyQuality::of(joints, &skeleton, 0.0)
                    .jerk_largest
                    .unwrap()
            });
            assert!(after < 1.7 * before, "{slide}: {before} {after}");
        }
    }

    #[test]
    fn legs_that_are_too_short_are_stretched_and_reported() {
        // The body slides further than its strides reach.
        let skeleton = Skeleton::humanml3d();
        let slid = sliding_walk(&skeleton, 0.4);
        let locked = lock_joints(
            &slid,
            &slid,
            &skeleton,
            &ContactRule::default(),
            Planted::Still,
            0.0,
        )
        .unwrap();
        assert!(locked.missed > 0.02, "{}", locked.missed);
        assert!(locked.after < 0.6 * locked.before, "{}", locked.after);
        // A foot that moves as in its source slides rather than leaves the floor.
        let walk = sliding_walk(&skeleton, 0.0);
        let rule = ContactRule::default();
        let eased = lock_joints(&slid, &walk, &skeleton, &rule, Planted::AsSeen, 0.0).unwrap();
        assert!(
            eased.missed > 0.02 && eased.after < eased.before,
            "{eased:?}"
        );
        for leg in skeleton.legs() {
            let both = slid
                .track(leg.sole)
                .into_iter()
                .zip(eased.joints.track(leg.sole));
            assert!(
                both.map(|(old, new)| new[1] - old[1])
                    .fold(f64::MIN, f64::max)
                    < 1e-3
            );
        }
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
    fn a_clean_walk_stays_as_it_is_and_a_longer_stride_is_as_smooth() {
        let skeleton = Skeleton::humanml3d();
        let walk = sliding_walk(&skeleton, 0.0);
        let rule = ContactRule::default();
        let locked = lock_joints(&walk, &walk, &skeleton, &rule, Planted::AsSeen, 0.0).unwrap();
        let own = BodyQuality::of(&walk, &skeleton, 0.0);
        let found = BodyQuality::of(&locked.joints, &skeleton, 0.0);
        assert!(
            found.jerk_largest.unwrap() < 1.3 * own.jerk_largest.unwrap(),
            "{found:?} {own:?}"
        );
        assert!(found.foot_skating <= own.foot_skating, "{found:?} {own:?}");
        // Feet that slide forward stand still and catch up within their step.
        let slid = sliding_walk(&skeleton, 0.15);
        let locked = lock_joints(&slid, &walk, &skeleton, &rule, Planted::AsSeen, 0.0).unwrap();
        let found = BodyQuality::of(&locked.joints, &skeleton, 0.0);
        assert!(
            locked.after < 0.6 * locked.before,
            "{} {}",
            locked.before,
            locked.after
        );
        assert!(
            found.jerk_largest.unwrap() < 2.0 * own.jerk_largest.unwrap(),
            "{found:?} {own:?}"
        );
        assert_eq!(found.floating, own.floating);
    }

    #[test]
    fn a_body_that_never_stands_is_left_as_it_is() {
        let skeleton = Skeleton::humanml3d();
        let walk = sliding_walk(&skeleton, -0.4);
        let above = walk.as_slice().iter().map(|[x, y, z]| [*x, y + 0.3, *z]);
        let flying = Joints::new(above.collect(), 22).unwrap();
        let rule = ContactRule::default();
        let locked = lock_joints(&flying, &flying, &skeleton, &rule, Planted::Still, 0.0).unwrap();
        assert_eq!(locked.joints, flying);
        // On a floor at that height it stands as often as the walk does on its own.
        let on_floor =
            lock_joints(&flying, &flying, &skeleton, &rule, Planted::Still, 0.3).unwrap();
        let own = lock_joints(&walk, &walk, &skeleton, &rule, Planted::Still, 0.0).unwrap();
        assert!(own.in_contact > 0.1 && on_floor.in_contact == own.in_contact);
        assert_eq!(
            (locked.in_contact, locked.before, locked.missed),
            (0.0, 0.0, 0.0)
        );
        // Contacts of other joints count.
        let locked = lock_joints(
            &flying,
            &walk,
            &skeleton,
            &ContactRule::default(),
            Planted::Still,
            0.0,
        )
        .unwrap();
        assert!(locked.after < 0.02 * locked.before && locked.joints != flying);
        let short = Joints::new(walk.as_slice()[..22].to_vec(), 22).unwrap();
        assert!(
            lock_joints(
                &walk,
                &short,
                &skeleton,
                &ContactRule::default(),
                Planted::Still,
                0.0
            )
            .is_err()
        );
        assert!(
            lock_joints(
                &walk,
                &walk,
                &Skeleton::kit(),
                &ContactRule::default(),
                Planted::Still,
                0.0
            )
            .is_err()
        );
    }
}
