use super::*;

const PARENTS: [Option<usize>; 6] = [None, Some(0), Some(1), Some(2), Some(3), Some(1)];
const LEG: Leg = Leg {
    hip: 1,
    knee: 2,
    ankle: 3,
    sole: 4,
};

/// A pelvis, a leg with a toe, and a pocket on the thigh, all sliding at constant speed.
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
    // The sole does not jump, and the correction is zero five frames away.
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
fn close_contacts_are_locked_at_their_own_positions() {
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

#[test]
fn legs_of_different_bones_are_locked_at_their_own_positions() {
    // A pelvis with a long right and a short left leg.
    let parents = [None, Some(0), Some(1), Some(2), Some(0), Some(4), Some(5)];
    let legs = [1, 4].map(|hip| Leg {
        hip,
        knee: hip + 1,
        ankle: hip + 2,
        sole: hip + 2,
    });
    let frame = |t: usize| {
        let x = 0.02 * t as f64;
        let places = [
            [0.0, 1.0, 0.0],
            [0.1, 1.0, 0.0],
            [0.1, 0.55, 0.2],
            [0.1, 0.1, 0.0],
            [-0.1, 1.0, 0.0],
            [-0.1, 0.7, 0.25],
            [-0.1, 0.2, 0.1],
        ];
        places.map(|[a, b, c]| [a + x, b, c]).to_vec()
    };
    let motion: Vec<_> = (0..25).map(frame).collect();
    let contacts = [3..9, 11..21].map(|run| (0..25).map(|t| run.contains(&t)).collect::<Vec<_>>());
    let locked = lock(&motion, &parents, &legs, &contacts, 2);
    for ((leg, contacts), missed) in legs.iter().zip(&contacts).zip(&locked.missed) {
        let path: Vec<_> = locked.positions.iter().map(|f| f[leg.sole]).collect();
        assert!(sliding(&path, contacts) < 1e-9);
        assert!(missed.iter().all(|left| *left < 1e-9));
        for (t, (new, old)) in locked.positions.iter().zip(&motion).enumerate() {
            for [a, b] in [[leg.hip, leg.knee], [leg.knee, leg.ankle]] {
                let bone = |f: &[[f64; 3]]| length(minus(f[a], f[b]));
                assert!((bone(new) - bone(old)).abs() < 1e-9);
            }
            // Only the two frames beside a contact change.
            let near = (t.saturating_sub(2)..(t + 3).min(25)).any(|t| contacts[t]);
            assert_eq!(new[leg.knee] == old[leg.knee], !near, "frame {t}");
        }
    }
}

#[test]
fn a_place_out_of_reach_leaves_the_knee_on_its_side() {
    // The body walks over a locked foot: the leg is bent, then straight, then far too short.
    let mut motion = sliding_leg(60);
    for (t, frame) in motion.iter_mut().enumerate() {
        frame
            .iter_mut()
            .for_each(|place| place[2] += 0.04 * t as f64);
    }
    let locked = lock(&motion, &PARENTS, &[LEG], &[vec![true; 60]], 3);
    let missed = &locked.missed[0];
    assert!(missed[0] > 0.5 && missed[59] > 0.5, "{missed:?}");
    assert!(missed.iter().any(|left| *left < 1e-9), "reached in between");
    let mut sides = Vec::new();
    for (frame, left) in locked.positions.iter().zip(missed) {
        let [hip, knee, ankle] = [1, 2, 3].map(|joint| frame[joint]);
        let (thigh, shin) = (length(minus(knee, hip)), length(minus(ankle, knee)));
        let reach = length(minus(ankle, hip));
        assert!(reach <= thigh + shin + 1e-12);
        if *left > 1e-6 {
            assert!(reach > 0.9998 * (thigh + shin), "stretched");
        }
        let along = minus(ankle, hip).map(|value| value / reach);
        let out = minus(knee, hip);
        let inner: f64 = (0..3).map(|axis| out[axis] * along[axis]).sum();
        // The knee is in front of the leg (+z), or above a leg that lies down.
        let front = (out[2] - inner * along[2]) + (out[1] - inner * along[1]).max(0.0);
        sides.push(front);
    }
    assert!(sides.iter().all(|front| *front > 0.0), "{sides:?}");
}

#[test]
fn a_straight_leg_bends_towards_its_toes() {
    let straight = vec![
        [0.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.5, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.2],
        [0.0, 0.7, 0.0],
    ];
    let mut motion = vec![straight; 8];
    // The body sinks by a centimetre per frame; the foot is locked at its mean position.
    for (t, frame) in motion.iter_mut().enumerate() {
        frame
            .iter_mut()
            .for_each(|place| place[1] -= 0.01 * t as f64);
    }
    let locked = lock(&motion, &PARENTS, &[LEG], &[vec![true; 8]], 3);
    let last = &locked.positions[7];
    assert!(locked.missed[0][7] < 1e-9);
    assert!(
        last[2][2] > 0.05 && last[2][0].abs() < 1e-9,
        "{:?}",
        last[2]
    );
    // A fully straight leg that would have to be longer does not change.
    assert!(locked.missed[0][0] > 0.03);
    assert!(length(minus(locked.positions[0][3], motion[0][3])) < 1e-9);
}
