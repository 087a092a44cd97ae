use proptest::prelude::*;

use super::*;
use crate::phrase::{POSITION, VELOCITY};
use crate::random_phrase::random_phrase;
use crate::{channel_name, mirror};

/// All combinations.
fn all() -> Vec<ChannelEncoding> {
    use OrientationEncoding::{CanonicalQuaternion, Quaternion, Rotation6d};
    let phases = [
        PhaseEncoding::Scalar,
        PhaseEncoding::SinCos,
        PhaseEncoding::Harmonics,
    ];
    let of_phase = |phase| {
        [Quaternion, CanonicalQuaternion, Rotation6d]
            .map(|orientation| ChannelEncoding { phase, orientation })
    };
    phases.into_iter().flat_map(of_phase).collect()
}

/// A phrase that turns about all axes, whose quaternions change sign and whose phase wraps.
fn phrase(seed: u64, frames: usize) -> Phrase {
    let mut motion = random_phrase(seed, frames);
    for t in 0..frames {
        let angle = 0.4 * t as f64 + seed as f64;
        let unit = Quaternion::from_rotation_vector([angle.sin(), 1.3 * angle, 0.7]);
        let sign = if t % 3 == 1 { -1.0 } else { 1.0 };
        motion.set_quaternion(t, unit.scale(sign));
        motion.frame_mut(t)[PHASE] = (0.13 * t as f64 + 0.91).rem_euclid(1.0) as f32;
    }
    motion
}

/// Distance of two phases in the bar.
fn apart(a: f32, b: f32) -> f32 {
    let difference = a - b;
    (difference - difference.round()).abs()
}

#[test]
fn the_stored_channels_stay_bit_for_bit() {
    let motion = phrase(3, 17);
    let targets = ChannelEncoding::default();
    assert_eq!(targets.channels(), CHANNELS);
    assert_eq!(targets.encode(motion.as_slice()), motion.as_slice());
    assert_eq!(
        targets.decode(motion.as_slice().to_vec()),
        motion.as_slice()
    );
    let moments = ChannelMoments::measure(CHANNELS, [motion.as_slice()]);
    let statistics = crate::phrase_statistics([&motion]).unwrap();
    let own = targets.statistics(moments);
    assert_eq!((&own.mean, &own.std), (&statistics.mean, &statistics.std));
    assert_eq!(own.range, statistics.range);
    assert_eq!(targets.mirrored_channels(), mirrored_channels());
}

#[test]
fn encoding_is_undone_by_decoding() {
    for targets in all() {
        for seed in 0..4 {
            let motion = phrase(seed, 23);
            let encoded = targets.encode(motion.as_slice()).into_owned();
            assert_eq!(encoded.len(), 23 * targets.channels());
            let decoded = Phrase::new(targets.decode(encoded)).unwrap();
            let mut expected = motion.clone();
            if targets.orientation == OrientationEncoding::CanonicalQuaternion {
                rotate_yaw(&mut expected, -motion.quaternion(0).yaw());
            }
            for t in 0..23 {
                let (found, expected) = (decoded.frame(t), expected.frame(t));
                for channel in (0..CHANNELS).filter(|c| !QUATERNION.contains(c)) {
                    let error = match channel {
                        PHASE => apart(found[channel], expected[channel]),
                        _ => (found[channel] - expected[channel]).abs(),
                    };
                    let name = channel_name(channel);
                    assert!(error < 1e-6, "{targets:?}, {name} of frame {t}: {error}");
                }
            }
            for t in 0..23 {
                let dot = decoded.quaternion(t).dot(expected.quaternion(t));
                assert!(
                    (dot.abs() - 1.0).abs() < 1e-6,
                    "{targets:?}, frame {t}: {dot}"
                );
            }
            if targets.orientation != OrientationEncoding::Quaternion {
                assert!(decoded.quaternion(0).w >= 0.0);
                let continuous = |t| decoded.quaternion(t).dot(decoded.quaternion(t - 1)) >= 0.0;
                assert!((1..23).all(continuous), "{targets:?}");
            }
        }
    }
}

#[test]
fn neighbouring_phases_and_both_quaternions_of_a_rotation_are_near() {
    let targets = ChannelEncoding {
        phase: PhaseEncoding::SinCos,
        orientation: OrientationEncoding::Rotation6d,
    };
    let motion = phrase(1, 1);
    let with = |phase: f32, sign: f64| {
        let mut changed = motion.clone();
        changed.frame_mut(0)[PHASE] = phase;
        changed.set_quaternion(0, motion.quaternion(0).scale(sign));
        targets.encode(changed.as_slice()).into_owned()
    };
    let distance = |a: &[f32], b: &[f32]| -> f32 {
        let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f32>().sqrt()
    };
    assert!(distance(&with(0.999, 1.0), &with(0.001, -1.0)) < 0.02);
    assert!(distance(&with(0.0, 1.0), &with(0.5, 1.0)) > 1.9);
}

#[test]
fn a_canonical_sample_faces_z_after_any_rotation() {
    let targets = ChannelEncoding {
        orientation: OrientationEncoding::CanonicalQuaternion,
        ..ChannelEncoding::default()
    };
    let motion = phrase(2, 9);
    let encoded = targets.encode(motion.as_slice()).into_owned();
    for angle in [0.4, 2.9, -1.7] {
        let mut turned = motion.clone();
        rotate_yaw(&mut turned, angle);
        let again = targets.encode(turned.as_slice()).into_owned();
        let largest = encoded.iter().zip(&again).map(|(a, b)| (a - b).abs());
        assert!(largest.fold(0.0, f32::max) < 3e-5);
    }
    let facing = Phrase::new(encoded).unwrap();
    assert!(facing.quaternion(0).yaw().abs() < 1e-6);
    let speed = |motion: &Phrase| crate::vector::length(motion.vector(4, VELOCITY));
    assert!((speed(&facing) - speed(&motion)).abs() < 1e-6);
    let height = |motion: &Phrase| motion.vector(4, POSITION)[1];
    assert!((height(&facing) - height(&motion)).abs() < 1e-6);
}

#[test]
fn mirroring_negates_the_channels_that_are_named() {
    for targets in all() {
        if targets.orientation == OrientationEncoding::CanonicalQuaternion {
            // The decoding turns the sample back too.
            continue;
        }
        let motion = phrase(5, 6);
        let mut mirrored = motion.clone();
        mirror(&mut mirrored);
        let (before, after) = (
            targets.encode(motion.as_slice()).into_owned(),
            targets.encode(mirrored.as_slice()).into_owned(),
        );
        let negated = targets.mirrored_channels();
        for (index, (before, after)) in before.iter().zip(&after).enumerate() {
            let channel = index % targets.channels();
            let sign = if negated.contains(&channel) {
                -1.0
            } else {
                1.0
            };
            assert!(
                (sign * before - after).abs() < 1e-6,
                "{targets:?}, {channel}"
            );
        }
    }
}

#[test]
fn statistics_leave_circles_and_rotations_as_they_are() {
    for targets in all() {
        let rows = targets.encode(phrase(1, 40).as_slice()).into_owned();
        let channels = targets.channels();
        let statistics = targets.statistics(ChannelMoments::measure(channels, [&rows[..]]));
        assert_eq!(statistics.channels(), channels);
        let orientation = targets.orientation_channels();
        assert!(
            statistics.std[orientation.clone()]
                .iter()
                .all(|&std| std == 1.0)
        );
        assert!(statistics.mean[orientation].iter().all(|&mean| mean == 0.0));
        let normalized = statistics.normalize(&rows);
        let (low, high) = (0.0f32, 0.0f32);
        let phase = targets.phase_channels();
        let values = &normalized[phase.start * 40..phase.end * 40];
        let low = values.iter().copied().fold(low, f32::min);
        let high = values.iter().copied().fold(high, f32::max);
        assert!(low < -0.8 && high > 0.8, "{targets:?}: {low} {high}");
        if targets.phase != PhaseEncoding::Scalar {
            let [min, max] = statistics.range.unwrap();
            assert_eq!((min[phase.start], max[phase.end - 1]), (-1.0, 1.0));
        }
    }
}

#[test]
fn predictions_of_any_size_decode_and_numbers_that_are_none_stay() {
    let targets = ChannelEncoding {
        phase: PhaseEncoding::SinCos,
        orientation: OrientationEncoding::Rotation6d,
    };
    let channels = targets.channels();
    assert_eq!(channels, 28);
    let zeros = targets.decode(vec![0.0; 2 * channels]);
    assert!(zeros.iter().all(|value| value.is_finite()));
    assert_eq!(zeros[PHASE], 0.0);
    let norm: f32 = zeros[QUATERNION].iter().map(|part| part * part).sum();
    assert!((norm - 1.0).abs() < 1e-6);
    // A phase just below a full turn is the beginning of the next bar, not 1.
    let mut rows = vec![0.0; channels];
    rows[targets.phase_channels()].copy_from_slice(&[-1e-9, 1.0]);
    assert_eq!(targets.decode(rows)[PHASE], 0.0);
    let mut rows = vec![0.5; 3 * channels];
    rows[channels + targets.orientation_channels().start] = f32::NAN;
    let broken = Phrase::new(targets.decode(rows)).unwrap();
    assert!(broken.first_non_finite().is_some());
    assert!(broken.quaternion(2).norm().is_finite());
}

#[test]
fn beats_place_what_the_bar_leaves_open() {
    let targets = ChannelEncoding {
        phase: PhaseEncoding::Harmonics,
        ..ChannelEncoding::default()
    };
    let decoded = |bar: f64, of_bar: f32, beats: usize, beat: f64| {
        let mut rows = vec![0.0; targets.channels()];
        let phase = &mut rows[targets.phase_channels()];
        let mut say = |k: usize, angle: f64, size: f32| {
            phase[2 * k - 2] = size * angle.sin() as f32;
            phase[2 * k - 1] = size * angle.cos() as f32;
        };
        say(1, TAU * bar, of_bar);
        say(beats, TAU * beat, 1.0);
        f64::from(targets.decode(rows)[PHASE])
    };
    // The position in the bar is known roughly, the position in the beat precisely: 0.3 beats after
    // the second beat.
    for beats in [2, 3, 4] {
        let truth = 1.3 / beats as f64;
        for error in [-0.06, 0.0, 0.08] {
            let found = decoded(truth + error, 0.3, beats, 0.3);
            let left = (found - truth).abs();
            assert!(
                left < 0.1 * f64::abs(error) + 1e-6,
                "{beats}: {found} {truth}"
            );
        }
    }
    // The first beat of a bar is also near the end of the previous bar.
    assert!(decoded(0.98, 0.5, 4, 0.02) < 0.01);
    // A mean over all beats of a bar does not determine the bar.
    let mut mean = vec![0.0; targets.channels()];
    for beat in 0..4 {
        let mut motion = random_phrase(0, 1);
        motion.frame_mut(0)[PHASE] = 0.25 * beat as f32 + 0.05;
        let rows = targets.encode(motion.as_slice());
        mean.iter_mut()
            .zip(rows.iter())
            .for_each(|(sum, row)| *sum += row / 4.0);
    }
    let size = |k: usize| {
        let pair = &mean[targets.phase_channels()][2 * k - 2..2 * k];
        pair.iter().map(|part| part * part).sum::<f32>()
    };
    assert!([1, 2, 3].iter().all(|k| size(*k) < 1e-9) && (size(4) - 1.0).abs() < 1e-5);
}

proptest! {
    #[test]
    fn any_columns_give_a_rotation(columns in proptest::collection::vec(-5.0f64..5.0, 6)) {
        for unit in [from_columns(&columns), nearest_rotation(&columns)] {
            prop_assert!((unit.norm() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_columns_of_a_rotation_give_it_back(parts in proptest::collection::vec(-1.0f64..1.0, 4)) {
        let quaternion = Quaternion::new(parts[0], parts[1], parts[2], parts[3]);
        prop_assume!(quaternion.norm() > 1e-3);
        let unit = quaternion.normalised();
        let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|axis| unit.rotate(axis));
        for found in [from_columns(&columns.concat()), nearest_rotation(&columns.concat())] {
            prop_assert!((found.dot(unit).abs() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn no_rotation_is_nearer_to_the_columns(
        columns in proptest::collection::vec(-2.0f64..2.0, 6),
        turn in proptest::collection::vec(-0.3f64..0.3, 3),
    ) {
        let apart = |rotation: Quaternion| -> f64 {
            let found = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|axis| rotation.rotate(axis));
            found.concat().iter().zip(&columns).map(|(a, b)| (a - b).powi(2)).sum()
        };
        let nearest = nearest_rotation(&columns);
        let turned = Quaternion::from_rotation_vector([turn[0], turn[1], turn[2]]) * nearest;
        prop_assert!(apart(nearest) <= apart(turned) + 1e-9);
    }

    #[test]
    fn phases_come_back_in_the_bar(phase in 0.0f32..1.0, radius in 0.01f32..3.0) {
        let targets = ChannelEncoding { phase: PhaseEncoding::SinCos, ..ChannelEncoding::default() };
        let mut motion = random_phrase(0, 1);
        motion.frame_mut(0)[PHASE] = phase;
        let mut rows = targets.encode(motion.as_slice()).into_owned();
        rows[targets.phase_channels()].iter_mut().for_each(|value| *value *= radius);
        let found = targets.decode(rows)[PHASE];
        prop_assert!((0.0..1.0).contains(&found));
        prop_assert!(apart(found, phase) < 1e-6, "{found} {phase}");
    }
}

#[test]
fn a_dancer_whose_heading_is_open_stands_upright() {
    // The remaining side axis points slightly upward; the up axis is certain.
    let columns = [0.001, 0.004, -0.002, 0.05, 0.96, -0.02];
    let tilt = |rotation: Quaternion| rotation.rotate([0.0, 1.0, 0.0])[1].acos().to_degrees();
    assert!(tilt(nearest_rotation(&columns)) < 5.0);
    assert!(tilt(from_columns(&columns)) > 45.0);
}

#[test]
fn a_mean_of_orientations_that_differ_is_unsure() {
    for orientation in [
        OrientationEncoding::CanonicalQuaternion,
        OrientationEncoding::Rotation6d,
    ] {
        let targets = ChannelEncoding {
            orientation,
            ..ChannelEncoding::default()
        };
        let encoded = |turn: f64| {
            let mut motion = random_phrase(3, 2);
            // The first frame of a canonical sample is at rest.
            motion.set_quaternion(0, Quaternion::IDENTITY);
            motion.set_quaternion(1, Quaternion::from_rotation_vector([turn, 0.4 * turn, 0.0]));
            targets.encode(motion.as_slice()).into_owned()
        };
        let mean = |a: &[f32], b: &[f32]| -> Vec<f32> {
            a.iter().zip(b).map(|(a, b)| (a + b) / 2.0).collect()
        };
        let of = |turn: f64| targets.confidence(&mean(&encoded(turn), &encoded(-turn)));
        let [none, some, much] = [0.0, 0.6, 1.5].map(of);
        assert!((none[1] - 1.0).abs() < 1e-6, "{none:?}");
        assert!(some[1] < 0.96 && much[1] < 0.75, "{some:?} {much:?}");
        for sure in [none, some, much] {
            assert!((sure[0] - 1.0).abs() < 1e-6, "{sure:?}");
        }
    }
    let mut rows = vec![0.5; CHANNELS];
    rows[QUATERNION.start] = f32::NAN;
    rows[QUATERNION.start] = 0.0;
    rows[QUATERNION].copy_from_slice(&[0.0, 0.3, 0.0, 0.4]);
    let [sure] = ChannelEncoding::default().confidence(&rows)[..] else {
        panic!("one frame")
    };
    assert!((sure - 0.5).abs() < 1e-6);
}
