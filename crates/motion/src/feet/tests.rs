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

/// The motion with soles that stay in their places in contact.
fn still(
    motion: &[Vec<[f64; 3]>],
    parents: &[Option<usize>],
    legs: &[Leg],
    contacts: &[Vec<bool>],
    fade: f64,
) -> Locked {
    let standing = Standing {
        contacts,
        steps: &vec![vec![[0.0; 3]; motion.len() - 1]; legs.len()],
        fade,
        firmness: FIRM,
        up: 1,
    };
    lock(motion, parents, legs, &standing)
}

fn track(frames: &[Vec<[f64; 3]>], joint: usize) -> Vec<[f64; 3]> {
    frames.iter().map(|frame| frame[joint]).collect()
}

#[test]
fn feet_stay_in_contact_and_bones_keep_their_lengths() {
    let motion = sliding_leg(120);
    let contacts: Vec<bool> = (0..120).map(|t| (50..60).contains(&t)).collect();
    let locked = still(
        &motion,
        &PARENTS,
        &[LEG],
        std::slice::from_ref(&contacts),
        5.0,
    );
    let [before, after] = [&motion, &locked.positions].map(|frames| track(frames, 4));
    assert!((sliding(&before, &contacts, 1) - 0.01).abs() < 1e-12);
    assert!(sliding(&after, &contacts, 1) < 3e-4);
    assert!(locked.missed[0] < 2e-3, "{:?}", locked.missed);
    for (frame, old) in locked.positions.iter().zip(&motion) {
        for joint in 1..6 {
            let parent = PARENTS[joint].unwrap();
            let bone = |frame: &[[f64; 3]]| length(minus(frame[joint], frame[parent]));
            assert!((bone(frame) - bone(old)).abs() < 1e-9);
        }
        assert_eq!(frame[..2], old[..2]);
        assert!((frame[4][1] - old[4][1]).abs() < 1e-9, "heights stay");
    }
    // The sole catches up as smoothly as possible, and is where it was far away.
    let steps: Vec<f64> = (after.windows(2))
        .map(|pair| length(minus(pair[1], pair[0])))
        .collect();
    assert!(steps.iter().all(|step| *step < 0.03), "{steps:?}");
    let jumps = steps.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    assert!(jumps.fold(0.0, f64::max) < 0.006);
    for t in [0, 119] {
        let moved = length(minus(before[t], after[t]));
        assert!(moved < 5e-3, "{moved}");
    }
}

#[test]
fn turns_lead_to_the_same_places() {
    let motion = sliding_leg(12);
    let locked = still(&motion, &PARENTS, &[LEG], &[vec![true; 12]], 3.0);
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
    let locked = still(
        &motion,
        &PARENTS,
        &[LEG],
        std::slice::from_ref(&contacts),
        6.0,
    );
    let path = track(&locked.positions, 4);
    assert!(sliding(&path, &contacts, 1) < 1e-3);
    assert!(path[11][0] - path[8][0] > 0.05);
}

#[test]
fn a_place_out_of_reach_is_approached_on_the_floor() {
    let mut motion = sliding_leg(2);
    motion[1].iter_mut().for_each(|place| place[0] += 3.0);
    let locked = still(&motion, &PARENTS, &[LEG], &[vec![true; 2]], 3.0);
    assert!(locked.missed[0] > 1.0);
    for (frame, old) in locked.positions.iter().zip(&motion) {
        let (new, old) = (minus(frame[3], frame[1]), minus(old[3], old[1]));
        assert!((new[1] - old[1]).abs() < 1e-9);
        assert!(new[0].abs() > 0.15 && length(new) < 0.9, "{new:?}");
    }
}

#[test]
fn the_axis_of_heights_may_be_another() {
    let upright = sliding_leg(30);
    let lying: Vec<Vec<[f64; 3]>> = (upright.iter())
        .map(|frame| frame.iter().map(|[x, y, z]| [-z, *x, *y]).collect())
        .collect();
    let contacts = [(0..30).map(|t| (8..22).contains(&t)).collect::<Vec<_>>()];
    let standing = Standing {
        contacts: &contacts,
        steps: &[vec![[0.0; 3]; 29]],
        fade: 5.0,
        firmness: FIRM,
        up: 2,
    };
    let lying = lock(&lying, &PARENTS, &[LEG], &standing);
    let upright = still(&upright, &PARENTS, &[LEG], &contacts, 5.0);
    for (lying, upright) in lying.positions.iter().zip(&upright.positions) {
        for (found, [x, y, z]) in lying.iter().zip(upright) {
            assert!(length(minus(*found, [-z, *x, *y])) < 1e-9);
        }
    }
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
        let x = 0.01 * t as f64;
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
    let locked = still(&motion, &parents, &legs, &contacts, 2.0);
    for ((leg, contacts), missed) in legs.iter().zip(&contacts).zip(&locked.missed) {
        assert!(sliding(&track(&locked.positions, leg.sole), contacts, 1) < 5e-4);
        assert!(*missed < 5e-3, "{missed}");
        for (new, old) in locked.positions.iter().zip(&motion) {
            for [a, b] in [[leg.hip, leg.knee], [leg.knee, leg.ankle]] {
                let bone = |f: &[[f64; 3]]| length(minus(f[a], f[b]));
                assert!((bone(new) - bone(old)).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_place_out_of_reach_leaves_the_knee_on_its_side() {
    // The body walks over a locked foot: the leg is straight, then bent, then straight again.
    let mut motion = sliding_leg(60);
    for (t, frame) in motion.iter_mut().enumerate() {
        frame
            .iter_mut()
            .for_each(|place| place[2] += 0.04 * t as f64);
    }
    let locked = still(&motion, &PARENTS, &[LEG], &[vec![true; 60]], 3.0);
    assert!(locked.missed[0] > 0.5, "{:?}", locked.missed);
    let mut sides = Vec::new();
    for frame in &locked.positions {
        let [hip, knee, ankle] = [1, 2, 3].map(|joint| frame[joint]);
        let (thigh, shin) = (length(minus(knee, hip)), length(minus(ankle, knee)));
        let reach = length(minus(ankle, hip));
        assert!(reach <= SUPPLE * (thigh + shin) + 1e-9);
        let along = minus(ankle, hip).map(|value| value / reach);
        let out = minus(knee, hip);
        let inner: f64 = (0..3).map(|axis| out[axis] * along[axis]).sum();
        // The knee is in front of the leg (+z).
        sides.push(out[2] - inner * along[2]);
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
    // The body sinks by a centimetre per frame; the foot stays at one height.
    for (t, frame) in motion.iter_mut().enumerate() {
        frame
            .iter_mut()
            .for_each(|place| place[1] -= 0.01 * t as f64);
    }
    let locked = still(&motion, &PARENTS, &[LEG], &[vec![true; 8]], 3.0);
    let last = &locked.positions[7];
    assert!(
        last[2][2] > 0.05 && last[2][0].abs() < 1e-9,
        "{:?}",
        last[2]
    );
    // A straight leg that would have to be longer does not change.
    assert!(length(minus(locked.positions[0][3], motion[0][3])) < 1e-6);
}
