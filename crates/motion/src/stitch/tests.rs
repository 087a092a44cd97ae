use super::*;
use crate::phrase::PHASE;
use crate::random_phrase::random_phrase;
use crate::{CHANNELS, Phrase, anchor_floor};

/// The windows of a motion, each anchored at its start.
fn cut(windows: &Windows, motion: &Phrase) -> Vec<f32> {
    let parts = (0..windows.len()).map(|window| {
        let mut part = motion.slice(windows.of(window));
        anchor_floor(&mut part);
        part.channel_major()
    });
    parts.flatten().collect()
}

fn assert_near(found: &[f32], expected: &[f32], allowed: f32) {
    assert_eq!(found.len(), expected.len());
    for (place, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= allowed, "{place}: {a} {b}");
    }
}

#[test]
fn windows_cover_all_frames_and_overlap() {
    for (frames, length) in [
        (1, 1),
        (7, 24),
        (24, 24),
        (25, 24),
        (100, 24),
        (101, 7),
        (9, 1),
    ] {
        let windows = Windows::new(frames, length);
        let starts = windows.starts();
        assert_eq!(windows.length(), length.min(frames));
        assert_eq!((starts[0], windows.of(windows.len() - 1).end), (0, frames));
        for pair in starts.windows(2) {
            let apart = pair[1] - pair[0];
            assert!(
                apart > 0 && apart <= most_apart(length),
                "{frames} {length}: {starts:?}"
            );
        }
        for t in 0..frames {
            let found = (0..windows.len()).filter(|&w| windows.of(w).contains(&t));
            assert_eq!(found.collect::<Vec<_>>(), windows.at(t).collect::<Vec<_>>());
        }
    }
    assert_eq!(Windows::new(24, 24).len(), 1);
    assert_eq!(Windows::new(25, 24).len(), 2);
}

#[test]
fn pieces_of_a_motion_make_the_motion() {
    let mut motion = random_phrase(4, 91);
    anchor_floor(&mut motion);
    let windows = Windows::new(91, 24);
    let mut values = cut(&windows, &motion);
    // All quaternion signs of a window may be flipped.
    for channel in QUATERNION {
        let first = (2 * CHANNELS + channel) * 24;
        values[first..first + 24]
            .iter_mut()
            .for_each(|v| *v *= -1.0);
    }
    let before = values.clone();
    let stitched = windows.stitch(&mut values, None, Layout::Phrase);
    let stitched = Phrase::from_channel_major(&stitched, 91).unwrap();
    for t in 0..91 {
        assert_near(&stitched.frame(t)[..9], &motion.frame(t)[..9], 2e-5);
        assert!(stitched.quaternion(t).dot(motion.quaternion(t)).abs() > 1.0 - 1e-6);
    }
    assert_near(&values, &before, 2e-5);
}

#[test]
fn phases_are_blended_on_their_circle() {
    let windows = Windows::new(36, 24);
    let mut values = vec![0.0; windows.len() * CHANNELS * 24];
    for (window, phase) in [0.98, 0.02].into_iter().enumerate() {
        let first = (window * CHANNELS + PHASE) * 24;
        values[first..first + 24].fill(phase);
    }
    let motion = windows.stitch(&mut values, None, Layout::Phrase);
    for phase in &motion[PHASE * 36..(PHASE + 1) * 36] {
        assert!(
            (0.0..0.021).contains(phase) || (0.979..=1.0).contains(phase),
            "{phase}"
        );
    }
}

#[test]
fn windows_in_other_encodings_make_the_motion() {
    let mut motion = random_phrase(4, 91);
    anchor_floor(&mut motion);
    let encoding = ChannelEncoding {
        phase: PhaseEncoding::SinCos,
        orientation: OrientationEncoding::Rotation6d,
    };
    let layout = Layout::Predicted(encoding);
    let columns = |motion: &Phrase| {
        let rows = encoding.encode(motion.as_slice()).into_owned();
        let channels = encoding.channels();
        (0..channels)
            .flat_map(|c| {
                rows.iter()
                    .skip(c)
                    .step_by(channels)
                    .copied()
                    .collect::<Vec<_>>()
            })
            .collect::<Vec<f32>>()
    };
    let windows = Windows::new(91, 24);
    let parts = (0..windows.len()).map(|window| {
        let mut part = motion.slice(windows.of(window));
        anchor_floor(&mut part);
        columns(&part)
    });
    let mut values: Vec<f32> = parts.flatten().collect();
    let before = values.clone();
    let stitched = windows.stitch(&mut values, None, layout);
    assert_near(&stitched, &columns(&motion), 2e-5);
    assert_near(&values, &before, 2e-5);
    // Known frames in these channels stay too, and the difference fades.
    let known = KnownFrames {
        is_known: (0..91).map(|t| (30..40).contains(&t)).collect(),
        values: columns(&motion),
    };
    let mut still = vec![0.0; values.len()];
    let stitched = windows.stitch(&mut still, Some(&known), layout);
    let sine = encoding.phase_channels().start * 91;
    assert_eq!(
        stitched[sine + 30..sine + 40],
        known.values[sine + 30..sine + 40]
    );
    assert!(stitched[sine + 41].abs() > 0.0 && stitched[sine + 60] == 0.0);
}

#[test]
fn predicted_phases_of_one_number_are_blended_around_the_bar() {
    // Two slightly different windows across the end of a bar.
    let windows = Windows::new(30, 20);
    assert_eq!(windows.starts(), [0, 10]);
    let layout = Layout::Predicted(ChannelEncoding::default());
    let turn = |window: usize, t: usize| 0.9 + 0.01 * t as f64 + 0.04 * window as f64;
    let mut values = vec![0.0; 2 * CHANNELS * 20];
    for (window, values) in values.chunks_mut(CHANNELS * 20).enumerate() {
        for (t, value) in values[PHASE * 20..][..20].iter_mut().enumerate() {
            let turn = turn(window, t + windows.starts()[window]);
            *value = (2.0 * turn.rem_euclid(1.0) - 1.0) as f32;
        }
    }
    let stitched = windows.stitch(&mut values, None, layout);
    for (t, value) in stitched[PHASE * 30..][..30].iter().enumerate() {
        let found = 0.5 * f64::from(*value) + 0.5;
        let between = turn(0, t) + 0.02;
        let apart = crate::circular::distance(found, between);
        assert!(
            (0.0..=1.0).contains(&found) && apart < 0.021,
            "{t}: {found} {between}"
        );
    }
}

#[test]
fn windows_that_differ_agree_afterwards() {
    let windows = Windows::new(50, 20);
    let mut values: Vec<f32> = (0..windows.len())
        .flat_map(|window| random_phrase(window as u64, 20).channel_major())
        .collect();
    let motion = windows.stitch(&mut values, None, Layout::Phrase);
    let height = |window: usize, t: usize| {
        values[(window * CHANNELS + 1) * 20 + t - windows.starts()[window]]
    };
    for t in 0..50 {
        for window in windows.at(t) {
            assert_eq!(height(window, t), motion[50 + t]);
        }
    }
    // A second stitching changes nothing.
    let again = windows.stitch(&mut values, None, Layout::Phrase);
    assert_near(&again, &motion, 1e-5);
}

#[test]
fn known_frames_are_exact_and_determine_the_position() {
    let mut motion = random_phrase(8, 70);
    for t in 0..70 {
        let [x, y, z] = motion.vector(t, POSITION);
        motion.set_vector(t, POSITION, [x + 40.0, y, z - 7.0]);
    }
    let windows = Windows::new(70, 24);
    let known = KnownFrames {
        is_known: (0..70).map(|t| (30..40).contains(&t)).collect(),
        values: motion.channel_major(),
    };
    let mut values = cut(&windows, &motion);
    let stitched = windows.stitch(&mut values, Some(&known), Layout::Phrase);
    for channel in 0..CHANNELS {
        let part = |values: &[f32]| values[channel * 70 + 30..channel * 70 + 40].to_vec();
        assert_eq!(part(&stitched), part(&known.values));
    }
    // The windows were cut from the motion, so stitching restores it.
    assert_near(&stitched[..70], &known.values[..70], 1e-4);
    // Different windows do not cause a step at the edge.
    let mut still = vec![0.0; values.len()];
    let stitched = windows.stitch(&mut still, Some(&known), Layout::Phrase);
    let height = |t: usize| stitched[70 + t];
    let (inside, next, far) = (height(39), height(40), height(51));
    assert!(
        (next - inside).abs() < 0.1 * inside.abs(),
        "{inside} {next}"
    );
    assert_eq!(far, 0.0);
}
