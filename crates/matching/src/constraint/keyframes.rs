//! All key frames of a level.

use super::Constraint;
use crate::Frames;

/// Least reach in frames of a level, about half a patch, so that patches of the source match from
/// the coarsest level on. Short levels have a shorter reach, to leave room for the noise.
const LEAST_REACH: usize = 6;
/// Least frames of a level for each frame of reach.
const FRAMES_PER_REACH: usize = 8;

/// A key frame of a level.
struct Key<'a> {
    t: usize,
    channels: &'a [usize],
    source: &'a Frames,
    from: usize,
    /// Source frames between two frames of the level.
    pace: f64,
    reach: usize,
}

/// [`Constraint::apply_all`] of key frames. Weights are summed before any frame changes.
pub(super) fn apply(constraints: &[Constraint], frames: &mut Frames, is_loop: bool) -> Vec<bool> {
    let n = frames.frames();
    let least = LEAST_REACH.min(n / FRAMES_PER_REACH);
    let mut keys = Vec::new();
    for constraint in constraints {
        if let Constraint::Keyframe {
            at,
            channels,
            source,
            from,
            frames: finest,
            reach,
        } = constraint
        {
            let pace = (*finest as f64 / n as f64).max(1.0);
            keys.push(Key {
                t: Constraint::frame(*at, n),
                channels,
                source,
                from: *from,
                pace,
                reach: ((*reach as f64 / pace).ceil() as usize).max(least),
            });
        }
    }
    if keys.is_empty() {
        return Vec::new();
    }
    // Key frames of each channel.
    let mut moments: Vec<Vec<usize>> = vec![Vec::new(); frames.channels()];
    for key in &keys {
        for &channel in key.channels {
            moments[channel].push(key.t);
        }
    }
    let mut weights = Frames::zeros(n, frames.channels());
    let mut sums = Frames::zeros(n, frames.channels());
    for key in &keys {
        let sharing = |channel: usize| moments[channel].iter().filter(|&&t| t == key.t).count();
        let shares = key.channels.iter().map(|&c| 1.0 / sharing(c) as f32);
        let shares: Vec<f32> = shares.collect();
        for ahead in [false, true] {
            let reaches = key.channels.iter().map(|&channel| {
                let next = nearest(&moments[channel], key.t, ahead, is_loop.then_some(n));
                let most = if is_loop { (n - 1) / 2 } else { usize::MAX };
                key.reach.min(most).min(next.unwrap_or(usize::MAX) - 1)
            });
            let reaches: Vec<usize> = reaches.collect();
            let furthest = reaches.iter().copied().max().unwrap_or(0);
            let room = match (is_loop, ahead) {
                (true, _) => n,
                (false, true) => n - 1 - key.t,
                (false, false) => key.t,
            };
            for away in usize::from(ahead)..=furthest.min(room) {
                let (t, moved) = match ahead {
                    true => ((key.t + away) % n, away as f64),
                    false => ((key.t + n - away) % n, -(away as f64)),
                };
                let pose = key.source.read(key.from as f64 + key.pace * moved);
                for (place, &channel) in key.channels.iter().enumerate() {
                    if away <= reaches[place] {
                        let weight = shares[place] * falloff(away, reaches[place]);
                        weights.frame_mut(t)[channel] += weight;
                        sums.frame_mut(t)[channel] += weight * pose[place];
                    }
                }
            }
        }
    }
    let all = weights.values().iter().zip(sums.values());
    for (value, (&weight, &sum)) in frames.values_mut().iter_mut().zip(all) {
        if weight > 0.0 {
            *value = (1.0 - weight) * *value + sum;
        }
    }
    let weights = weights.values().chunks_exact(frames.channels());
    weights.map(|row| row.iter().any(|&w| w > 0.0)).collect()
}

/// Distance from `t` to the next of the other `moments`, ahead or behind, around a loop of
/// `loop_frames` frames.
fn nearest(moments: &[usize], t: usize, ahead: bool, loop_frames: Option<usize>) -> Option<usize> {
    let others = moments.iter().copied().filter(|&other| other != t);
    let apart = others.filter_map(|other| {
        let apart = (other as i64 - t as i64) * if ahead { 1 } else { -1 };
        match loop_frames {
            Some(n) => Some(apart.rem_euclid(n as i64) as usize),
            None => usize::try_from(apart).ok(),
        }
    });
    apart.min()
}

/// Weight of a blend: 1 at the key frame, 0 beyond its reach, with zero slope at both.
pub(super) fn falloff(distance: usize, reach: usize) -> f32 {
    let part = distance as f32 / (reach + 1) as f32;
    1.0 - part * part * part * (10.0 - part * (15.0 - 6.0 * part))
}
