//! The time in which a body moves over the floor in one pose.

use crate::humanml::{Joints, Skeleton};
use crate::vector::{length, minus};

/// Length of the windows in which pose and feet are compared, seconds.
const WINDOW: f64 = 1.0;

/// Root mean square, over pairs of joints, of the deviation of their distance below which a pose stays
/// the same, metres. Captured people whose feet move have at least 0.007.
const SAME_POSE: f64 = 0.005;

/// Deviation of a foot's joint from its mean place from which on it moves, metres.
const MOVES: f64 = 0.01;

/// Longest time of [`BodyMeasure::Statue`](super::BodyMeasure::Statue), in windows of a second.
pub(super) fn longest_statue(joints: &Joints, skeleton: &Skeleton, fps: f64) -> f64 {
    let window = (WINDOW * fps).round().max(1.0) as usize;
    let windows = (joints.frames() + 1).saturating_sub(window);
    let (mut pose, mut pairs) = (vec![0.0; windows], 0);
    for a in 0..joints.joints() {
        for b in 0..a {
            let distances = (0..joints.frames()).map(|t| {
                let frame = joints.frame(t);
                length(minus(frame[a], frame[b]))
            });
            add(&mut pose, variances(distances, window));
            pairs += 1;
        }
    }
    let mut moving = vec![true; windows];
    for foot in skeleton.contact_joints() {
        let mut variance = vec![0.0; windows];
        let track = joints.track(foot);
        for axis in 0..3 {
            let places = track.iter().map(|place| place[axis]);
            add(&mut variance, variances(places, window));
        }
        let moves = variance.into_iter().map(|value| value >= MOVES * MOVES);
        moving
            .iter_mut()
            .zip(moves)
            .for_each(|(all, moves)| *all &= moves);
    }
    let same = SAME_POSE * SAME_POSE * f64::from(pairs);
    let statue = moving
        .into_iter()
        .zip(pose)
        .map(|(moves, pose)| moves && pose < same);
    let statue: Vec<bool> = statue.collect();
    let longest = statue.split(|statue| !statue).map(<[bool]>::len).max();
    let longest = longest.filter(|windows| *windows > 0);
    longest.map_or(0.0, |windows| (windows - 1 + window) as f64 / fps)
}

/// Adds values one by one.
fn add(sums: &mut [f64], values: impl Iterator<Item = f64>) {
    sums.iter_mut()
        .zip(values)
        .for_each(|(sum, value)| *sum += value);
}

/// The variance of each window of so many values.
fn variances(values: impl Iterator<Item = f64>, window: usize) -> impl Iterator<Item = f64> {
    let values: Vec<f64> = values.collect();
    let (mut sum, mut squares) = (0.0, 0.0);
    (0..values.len()).filter_map(move |t| {
        // Relative to the first value, for exactness.
        let at = |t: usize| values[t] - values[0];
        sum += at(t);
        squares += at(t) * at(t);
        if let Some(last) = t.checked_sub(window) {
            sum -= at(last);
            squares -= at(last) * at(last);
        }
        let count = window as f64;
        (t + 1 >= window).then(|| (squares - sum * sum / count) / count)
    })
}
