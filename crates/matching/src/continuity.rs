//! Matches that continue the one before them.

use crate::{Frames, Pool};

/// Replaces a match by the patch that follows the match before it, where that is at most
/// `tolerance` times the median distance of neighbouring example patches further away than the
/// nearest. In frames that are alike, the nearest patch changes with every frame, and the mean of
/// many patches slides and stands still. `nearest`: for each patch of `synthesis` the nearest patch
/// of `pool`.
pub(crate) fn continued(synthesis: &Frames, pool: &Pool, tolerance: f64, nearest: &mut [usize]) {
    let p = pool.patch_size;
    let distance = |one: &Frames, i: usize, patch: usize| -> f32 {
        let start = pool.start(patch);
        let frames = (0..p).map(|k| {
            let pairs = one.frame(i + k).iter().zip(pool.frames.frame(start + k));
            pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
        });
        frames.sum()
    };
    let next = |patch: usize| {
        let follows = patch + 1 < pool.patches && pool.origin(patch + 1).0 == pool.origin(patch).0;
        follows.then_some(patch + 1)
    };
    let steps = (0..pool.patches).filter_map(|patch| {
        let next = next(patch)?;
        Some(distance(&pool.frames, pool.start(patch), next))
    });
    let mut steps: Vec<f32> = steps.collect();
    steps.sort_unstable_by(f32::total_cmp);
    let Some(usual) = steps.get(steps.len() / 2) else {
        return;
    };
    let allowed = tolerance as f32 * usual;
    for i in 1..nearest.len() {
        if let Some(next) = next(nearest[i - 1]).filter(|next| *next != nearest[i])
            && distance(synthesis, i, next) <= distance(synthesis, i, nearest[i]) + allowed
        {
            nearest[i] = next;
        }
    }
}
