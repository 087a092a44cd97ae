//! Locks the feet of a new motion where the feet of its examples rest.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::feet::{FIRM, Leg, STEP_SECONDS, Standing, lock, without_short_runs};
use kinegrad_motion::vector::{length, minus};

use crate::motion_matrix::thinning;
use crate::parts::feet;
use crate::{Error, Example, Frames, MotionMatrix, Part, Sliding};

/// Speed in leg lengths a second below which a foot near the floor rests: 0.2 m/s for a person.
const RESTING: f64 = 0.25;
/// Height above the lowest sole position, in leg lengths, that counts as near the floor.
const NEAR: f64 = 0.15;
/// Shortest contact in frames; shorter gaps between contacts are closed.
const SHORTEST: usize = 3;
/// Copies of a loop that are locked together: the one in the middle continues on both sides.
const COPIES: usize = 3;

/// The legs of the skeleton. Fails if no foot has two bones above it.
pub(crate) fn known_legs(layout: &MotionMatrix) -> Result<Vec<Leg>, Error> {
    let parents: Vec<Option<usize>> = layout.joints().iter().map(|joint| joint.parent).collect();
    let legs = legs(layout, &parents);
    if legs.is_empty() {
        let problem = "no joint with two bones above it is called a foot, toe or ankle";
        let hint = "leave option `lock_feet` out: the feet of this skeleton are not known";
        return Err(Error::file(&layout.file, problem, hint));
    }
    Ok(legs)
}

/// The motion `bvh` of `frames` with its feet locked where the examples' feet rest. `origins`: for
/// each part the example and frame that each frame continues. `is_loop`: feet are also locked across
/// the seam. Fails if no foot has two bones above it.
pub(crate) fn lock_feet(
    layout: &MotionMatrix,
    (frames, bvh): (&Frames, &Bvh),
    examples: &[Example],
    parts: &[Part],
    origins: &[Vec<(usize, usize)>],
    is_loop: bool,
) -> Result<(Bvh, Sliding), Error> {
    let joints = layout.joints();
    let parents: Vec<Option<usize>> = joints.iter().map(|joint| joint.parent).collect();
    let legs = known_legs(layout)?;
    let rests = |example: &Example| resting(layout, &example.bvh, &legs);
    let rests: Vec<Vec<Vec<bool>>> = examples.iter().map(rests).collect();
    let copies = if is_loop { COPIES } else { 1 };
    let contacts = legs.iter().enumerate().map(|(index, leg)| {
        let part = parts.iter().position(|p| p.joints.contains(&leg.ankle));
        let origins = origins[part.unwrap_or(0)].iter();
        let flags = origins.map(|&(example, t)| rests[example][index][t]);
        let flags: Vec<bool> = flags.collect();
        without_short_runs(flags.repeat(copies), SHORTEST)
    });
    let contacts: Vec<Vec<bool>> = contacts.collect();
    let unrolled = layout.to_bvh(&Frames::joined(&vec![frames.clone(); copies]))?;
    let world: Vec<Vec<RootPose>> = (0..unrolled.frames()).map(|t| unrolled.world(t)).collect();
    let place = |frame: &Vec<RootPose>| frame.iter().map(|pose| pose.position).collect();
    let places: Vec<Vec<[f64; 3]>> = world.iter().map(place).collect();
    let up = layout.up as usize;
    let rising = |leg: &Leg| {
        let step = |pair: &[Vec<[f64; 3]>]| {
            let mut step = [0.0; 3];
            step[up] = minus(pair[1][leg.sole], pair[0][leg.sole])[up];
            step
        };
        places.windows(2).map(step).collect()
    };
    let standing = Standing {
        contacts: &contacts,
        steps: &legs.iter().map(rising).collect::<Vec<_>>(),
        fade: STEP_SECONDS / layout.frame_time(),
        firmness: FIRM,
        up,
    };
    let locked = lock(&places, &parents, &legs, &standing);
    let first = copies / 2 * bvh.frames();
    let mut locals = Vec::with_capacity(bvh.frames() * joints.len());
    for (t, world) in world[first..].iter().take(bvh.frames()).enumerate() {
        let mut poses = bvh.locals(t);
        for (leg, turns) in legs.iter().zip(&locked.turns) {
            let turns = turns[first + t];
            let above = parents[leg.hip].map(|joint| world[joint].orientation);
            let hip = turns.hip * world[leg.hip].orientation;
            let knee = turns.knee * world[leg.knee].orientation;
            poses[leg.hip].orientation = above.map_or(hip, |above| above.conjugate() * hip);
            poses[leg.knee].orientation = hip.conjugate() * knee;
            poses[leg.ankle].orientation = knee.conjugate() * world[leg.ankle].orientation;
        }
        locals.extend(poses);
    }
    let frame_time = layout.frame_time();
    let slid = Sliding::of(&places, &locked.positions, &legs, &standing, frame_time);
    Ok((bvh.reposed(bvh.frame_time(), &locals)?, slid))
}

/// A leg for each topmost foot joint; its sole is the first joint of the foot.
fn legs(layout: &MotionMatrix, parents: &[Option<usize>]) -> Vec<Leg> {
    let feet = feet(layout.joints());
    let below = |joint: usize| parents[joint].is_some_and(|parent| feet.contains(&parent));
    let ankles = feet.iter().filter(|&&foot| !below(foot));
    let leg = |&ankle: &usize| {
        let toe = feet.iter().find(|&&toe| parents[toe] == Some(ankle));
        Leg::above(ankle, *toe.unwrap_or(&ankle), parents)
    };
    let legs: Vec<Leg> = ankles.filter_map(leg).collect();
    // A joint shared by two legs is not a hip.
    let hangs = |joint: usize, top: usize| {
        let mut above = std::iter::successors(Some(joint), |&joint| parents[joint]);
        above.any(|joint| joint == top)
    };
    let own = |leg: &&Leg| legs.iter().filter(|o| hangs(o.ankle, leg.hip)).count() == 1;
    legs.iter().filter(own).copied().collect()
}

/// True where each sole rests near the floor, `[legs][frames]` after downsampling.
fn resting(layout: &MotionMatrix, bvh: &Bvh, legs: &[Leg]) -> Vec<Vec<bool>> {
    let (every, _) = thinning(bvh);
    let frames = (0..bvh.frames()).step_by(every);
    let world: Vec<Vec<RootPose>> = frames.map(|t| bvh.world(t)).collect();
    let joints = layout.joints();
    let rests = |leg: &Leg| {
        let size = length(joints[leg.knee].offset) + length(joints[leg.ankle].offset);
        let place = |t: usize| world[t][leg.sole].position;
        let height = |t: usize| place(t)[layout.up as usize];
        let floor = (0..world.len()).map(height).fold(f64::INFINITY, f64::min);
        let still = |t: usize| {
            let before = place(t.saturating_sub(1));
            let moved = length([0, 1, 2].map(|axis| place(t)[axis] - before[axis]));
            let near = height(t) - floor <= NEAR * size;
            t > 0 && near && moved <= RESTING * size * layout.frame_time()
        };
        (0..world.len()).map(still).collect()
    };
    legs.iter().map(rests).collect()
}
