//! Changes of a phrase that commute with differentiation and keep phase and style.

use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY};
use crate::{Phrase, Quaternion};

/// Turns the phrase about +y by `angle` radians (+z towards +x).
pub fn rotate_yaw(motion: &mut Phrase, angle: f64) {
    let turn = Quaternion::from_yaw(angle);
    for t in 0..motion.frames() {
        for channels in [POSITION, VELOCITY, ACCELERATION, ANGULAR_VELOCITY] {
            let turned = turn.rotate(motion.vector(t, channels.clone()));
            motion.set_vector(t, channels, turned);
        }
        motion.set_quaternion(t, turn * motion.quaternion(t));
    }
}

/// Reflects the phrase at the plane x = 0. The angular velocity is axial: its y and z are negated.
pub fn mirror(motion: &mut Phrase) {
    for t in 0..motion.frames() {
        for channels in [POSITION, VELOCITY, ACCELERATION] {
            let [x, y, z] = motion.vector(t, channels.clone());
            motion.set_vector(t, channels, [-x, y, z]);
        }
        let [x, y, z] = motion.vector(t, ANGULAR_VELOCITY);
        motion.set_vector(t, ANGULAR_VELOCITY, [x, -y, -z]);
        let [w, x, y, z] = motion.quaternion(t).parts();
        motion.set_quaternion(t, Quaternion::new(w, x, -y, -z));
    }
}

/// The channels that [`mirror`] negates.
pub fn mirrored_channels() -> [usize; 7] {
    let [rotation, quaternion] = [ANGULAR_VELOCITY.start, QUATERNION.start];
    [
        POSITION.start,
        VELOCITY.start,
        ACCELERATION.start,
        rotation + 1,
        rotation + 2,
        quaternion + 2,
        quaternion + 3,
    ]
}

/// Moves the phrase on the floor: the first frame is at x = z = 0.
pub fn anchor_floor(motion: &mut Phrase) {
    let [x0, _, z0] = motion.vector(0, POSITION);
    for t in 0..motion.frames() {
        let [x, y, z] = motion.vector(t, POSITION);
        motion.set_vector(t, POSITION, [x - x0, y, z - z0]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::derivatives::rederive;
    use crate::phrase::PHASE;
    use crate::random_phrase::random_phrase;
    use crate::{CHANNELS, Profile, channel_name, check};

    /// Rounding errors of single precision. Positions of about 1 m have errors of 1e-7 m, and each
    /// difference multiplies errors by 30 frames per second.
    fn rounding(channel: usize) -> f64 {
        match channel {
            c if POSITION.contains(&c) || QUATERNION.contains(&c) => 1e-6,
            c if VELOCITY.contains(&c) || ANGULAR_VELOCITY.contains(&c) => 3e-5,
            c if ACCELERATION.contains(&c) => 1e-3,
            _ => 0.0,
        }
    }

    fn assert_commutes(original: &Phrase, change: impl Fn(&mut Phrase)) {
        let mut changed = original.clone();
        change(&mut changed);
        let mut derived = changed.clone();
        rederive(&mut derived);
        for t in 0..original.frames() {
            assert!((changed.quaternion(t).norm() - 1.0).abs() < 1e-6);
            for channel in 0..CHANNELS {
                let difference = changed.frame(t)[channel] - derived.frame(t)[channel];
                assert!(
                    f64::from(difference).abs() <= rounding(channel),
                    "{} of frame {t} differs by {difference}",
                    channel_name(channel)
                );
            }
            assert_eq!(changed.frame(t)[PHASE..], original.frame(t)[PHASE..]);
        }
        let statistics = crate::phrase_statistics([original]).unwrap();
        let before = check(original, Profile::Strict, Some(&statistics));
        let after = check(&changed, Profile::Strict, Some(&statistics));
        assert!(before.passed && after.passed, "{before:?} {after:?}");
    }

    #[test]
    fn a_quarter_turn_takes_forward_to_the_right() {
        let mut motion = Phrase::new(vec![0.0; CHANNELS]).unwrap();
        motion.set_vector(0, POSITION, [0.0, 5.0, 1.0]);
        motion.set_vector(0, VELOCITY, [1.0, 0.0, 0.0]);
        motion.set_quaternion(0, Quaternion::IDENTITY);
        rotate_yaw(&mut motion, std::f64::consts::FRAC_PI_2);
        let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-6);
        assert!(near(motion.vector(0, POSITION), [1.0, 5.0, 0.0]));
        assert!(near(motion.vector(0, VELOCITY), [0.0, 0.0, -1.0]));
        assert!(near(
            motion.quaternion(0).rotate([0.0, 0.0, 1.0]),
            [1.0, 0.0, 0.0]
        ));
    }

    #[test]
    fn a_mirrored_body_faces_the_mirrored_direction() {
        let mut motion = random_phrase(5, 2);
        let forward = motion.quaternion(1).rotate([0.0, 0.0, 1.0]);
        mirror(&mut motion);
        let mirrored = motion.quaternion(1).rotate([0.0, 0.0, 1.0]);
        assert!(forward[0].abs() > 1e-2, "the example looks sideways");
        assert!((mirrored[0] + forward[0]).abs() < 1e-6);
        assert!((mirrored[1] - forward[1]).abs() < 1e-6);
        assert!((mirrored[2] - forward[2]).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn turning_commutes_with_derivation(seed: u64, angle in -7.0f64..7.0, frames in 4usize..40) {
            assert_commutes(&random_phrase(seed, frames), |motion| rotate_yaw(motion, angle));
        }

        #[test]
        fn mirroring_commutes_with_derivation(seed: u64, frames in 4usize..40) {
            assert_commutes(&random_phrase(seed, frames), mirror);
        }

        #[test]
        fn anchoring_commutes_with_derivation(seed: u64, frames in 4usize..40) {
            assert_commutes(&random_phrase(seed, frames), anchor_floor);
        }

        #[test]
        fn mirroring_twice_changes_nothing(seed: u64, frames in 1usize..20) {
            let original = random_phrase(seed, frames);
            let mut motion = original.clone();
            mirror(&mut motion);
            prop_assert_ne!(&motion, &original);
            mirror(&mut motion);
            prop_assert_eq!(motion, original);
        }

        #[test]
        fn turning_forth_and_back_changes_nothing(seed: u64, angle in -7.0f64..7.0) {
            let original = random_phrase(seed, 10);
            let mut motion = original.clone();
            rotate_yaw(&mut motion, angle);
            rotate_yaw(&mut motion, -angle);
            for (a, b) in motion.as_slice().iter().zip(original.as_slice()) {
                prop_assert!((a - b).abs() <= 1e-6 * b.abs().max(100.0));
            }
        }

        #[test]
        fn an_anchored_phrase_starts_at_the_origin(seed: u64) {
            let original = random_phrase(seed, 10);
            let mut motion = original.clone();
            anchor_floor(&mut motion);
            let [x, y, z] = motion.vector(0, POSITION);
            prop_assert_eq!((x, z), (0.0, 0.0));
            prop_assert_eq!(y, original.vector(0, POSITION)[1]);
        }
    }

    #[test]
    fn mirroring_negates_the_channels_that_it_names() {
        let original = random_phrase(3, 10);
        let mut mirrored = original.clone();
        mirror(&mut mirrored);
        for (t, channel) in (0..10).flat_map(|t| (0..CHANNELS).map(move |c| (t, c))) {
            let sign = match mirrored_channels().contains(&channel) {
                true => -1.0,
                false => 1.0,
            };
            let expected = sign * original.frame(t)[channel];
            assert_eq!(
                mirrored.frame(t)[channel],
                expected,
                "{}",
                channel_name(channel)
            );
        }
    }
}
