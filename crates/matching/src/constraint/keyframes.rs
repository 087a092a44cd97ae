//! Key frames of a level, all together.

use super::Constraint;
use crate::Frames;

/// Frames of a level that bend towards a key frame at least: about half a patch, so that patches of
/// its source match there from the coarsest level on. Less where a level is so short that little
/// would be left to the noise.
const LEAST_REACH: usize = 6;
/// A level has so many frames for each of these at least.
const FRAMES_PER_REACH: usize = 8;

/// A key frame of a level.
struct Key<'a> {
    t: usize,
    channels: &'a [usize],
    source: &'a Frames,
    from: usize,
    /// Frames of the source between two of the level.
    pace: f64,
    reach: usize,
}

/// Makes a level's motion pass its key frames. What they weigh is summed up before any frame changes,
/// so their order does not matter. Says of each frame whether it bends; nothing without key frames.
pub(super) fn apply(constraints: &[Constraint], frames: &mut Frames, around: bool) -> Vec<bool> {
    let n = frames.frames();
    let least = LEAST_REACH.min(n / FRAMES_PER_REACH);
    let keys = constraints
        .iter()
        .filter_map(|constraint| match constraint {
            Constraint::Channels { .. } => None,
            Constraint::Keyframe {
                at,
                channels,
                source,
                from,
                frames: finest,
                reach,
            } => {
                let pace = (*finest as f64 / n as f64).max(1.0);
                Some(Key {
                    t: Constraint::frame(*at, n),
                    channels,
                    source,
                    from: *from,
                    pace,
                    reach: ((*reach as f64 / pace).ceil() as usize).max(least),
                })
            }
        });
    let keys: Vec<Key<'_>> = keys.collect();
    if keys.is_empty() {
        return Vec::new();
    }
    // The key frames of each channel, and how many there are in one frame.
    let mut moments: Vec<Vec<usize>> = vec![Vec::new(); frames.channels()];
    for key in &keys {
        for &channel in key.channels {
            moments[channel].push(key.t);
        }
    }
    let mut weights = Frames::zeros(n, frames.channels());
    let mut sums = Frames::zeros(n, frames.channels());
    for key in &keys {
        let together = |channel: usize| moments[channel].iter().filter(|&&t| t == key.t).count();
        let shares = key.channels.iter().map(|&c| 1.0 / together(c) as f32);
        let shares: Vec<f32> = shares.collect();
        for ahead in [false, true] {
            let reaches = key.channels.iter().map(|&channel| {
                let next = nearest(&moments[channel], key.t, ahead, around.then_some(n));
                let most = if around { (n - 1) / 2 } else { usize::MAX };
                key.reach.min(most).min(next.unwrap_or(usize::MAX) - 1)
            });
            let reaches: Vec<usize> = reaches.collect();
            let furthest = reaches.iter().copied().max().unwrap_or(0);
            let room = match (around, ahead) {
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

/// Frames from `t` to the next other of `moments`, ahead or behind; in a loop of `around` frames on
/// around it.
fn nearest(moments: &[usize], t: usize, ahead: bool, around: Option<usize>) -> Option<usize> {
    let others = moments.iter().copied().filter(|&other| other != t);
    let apart = others.filter_map(|other| {
        let apart = if ahead {
            other as i64 - t as i64
        } else {
            t as i64 - other as i64
        };
        match around {
            Some(n) => Some(apart.rem_euclid(n as i64) as usize),
            None => usize::try_from(apart).ok(),
        }
    });
    apart.min()
}

/// 1 at a key frame and 0 beyond its reach, flat at both.
pub(super) fn falloff(distance: usize, reach: usize) -> f32 {
    let part = distance as f32 / (reach + 1) as f32;
    1.0 - part * part * part * (10.0 - part * (15.0 - 6.0 * part))
}
