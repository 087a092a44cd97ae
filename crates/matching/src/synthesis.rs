//! Synthesis: from a coarse start, level by level, by matching patches and voting.

use std::borrow::Cow;

use kinegrad_random::{Key, Purpose};
use kinegrad_settings::{InvalidSetting, Refused, in_range, require};

use crate::vote::{pad_loop, unpad_loop, vote, vote_loop};
use crate::{Constraint, Frames, Levels, Looping, Matches, Pool, Search, Settings, Start};

/// A group of channels matched by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Its name.
    pub name: String,
    /// Its channels; channels shared with other groups are averaged.
    pub channels: Vec<usize>,
}

impl Channels {
    /// True for all channels in order.
    fn are_all(&self, channels: usize) -> bool {
        self.channels.iter().copied().eq(0..channels)
    }

    /// These channels of a motion.
    fn of<'a>(&self, frames: &'a Frames) -> Cow<'a, Frames> {
        match self.are_all(frames.channels()) {
            true => Cow::Borrowed(frames),
            false => Cow::Owned(frames.columns(&self.channels)),
        }
    }
}

/// A new motion and its origins.
#[derive(Clone, Debug)]
pub struct Synthesis {
    /// The motion, `[frames, channels]`.
    pub frames: Frames,
    /// For each group, the example and frame that each frame of the motion continues,
    /// `[groups][frames]`, from the last step's patch around the frame.
    pub origins: Vec<Vec<(usize, usize)>>,
}

impl Synthesis {
    /// Rotates a loop to begin at the frame whose step and change of velocity are smallest,
    /// relative to the means of both.
    pub fn rotate_to_smoothest_seam(&mut self) {
        let n = self.frames.frames();
        let apart = |terms: [(usize, f32); 3]| {
            let [a, b, c] = terms.map(|(t, weight)| (self.frames.frame(t % n), weight));
            let sum = |i: usize| f64::from(a.1 * a.0[i] + b.1 * b.0[i] + c.1 * c.0[i]);
            let squares = (0..self.frames.channels()).map(|i| sum(i).powi(2));
            squares.sum::<f64>().sqrt()
        };
        // The step from frame t and the change of velocity at t + 1.
        let step = |t: usize| apart([(t, -1.0), (t + 1, 1.0), (t, 0.0)]);
        let turn = |t: usize| apart([(t, 1.0), (t + 1, -2.0), (t + 2, 1.0)]);
        let steps: Vec<f64> = (0..n).map(step).collect();
        let turns: Vec<f64> = (0..n).map(turn).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / n as f64 + f64::MIN_POSITIVE;
        let (all_steps, all_turns) = (mean(&steps), mean(&turns));
        let jump = |first: usize| {
            let last = (first + n - 1) % n;
            let turn = turns[(last + n - 1) % n].max(turns[last]);
            (steps[last] / all_steps).max(turn / all_turns)
        };
        let first = (0..n).min_by(|&a, &b| jump(a).total_cmp(&jump(b)));
        let first = first.unwrap_or(0);
        let channels = self.frames.channels();
        self.frames.values_mut().rotate_left(first * channels);
        for origins in &mut self.origins {
            origins.rotate_left(first);
        }
    }
}

/// The input of a synthesis.
pub struct Request<'a> {
    /// The examples, each `[frames, channels]`.
    pub examples: &'a [Frames],
    /// Frames of the new motion.
    pub frames: usize,
    /// The settings.
    pub settings: &'a Settings,
    /// Groups of channels that are matched separately and cover every channel. Empty: one group of
    /// all channels.
    pub groups: &'a [Channels],
    /// The constraints.
    pub constraints: &'a [Constraint],
}

impl Request<'_> {
    /// Lengths at all levels.
    ///
    /// # Errors
    /// As [`synthesize`].
    pub fn levels(&self) -> Result<Levels, InvalidSetting> {
        let settings = self.settings;
        settings.validate()?;
        let p = settings.patch_size;
        let lengths: Vec<usize> = self.examples.iter().map(Frames::frames).collect();
        let longest = lengths.iter().copied().max().unwrap_or(0);
        require(longest > 0, "examples", "empty", "one motion or more")?;
        for (index, frames) in lengths.iter().enumerate() {
            let found = format!("{p} with {frames} frames in example {}", index + 1);
            let allowed = "at most the frames of each example";
            require(*frames >= p, "patch_size", found, allowed)
                .hint("give a longer example, or a smaller patch")?;
        }
        in_range("length", self.frames, p..).hint("a motion has at least one patch")?;
        let coarse = settings.coarse_ratio.ratio(p, longest);
        let levels = Levels::new(&lengths, self.frames, coarse, settings.pyr_factor, p);
        Ok(levels)
    }
}

/// Standard normal noise of a seed for a start of `frames` frames. Each `attempt`, from 0, has its
/// own noise.
pub fn start_noise(seed: u64, attempt: u64, frames: usize, channels: usize) -> Frames {
    let key = Key::new(seed, Purpose::Matching);
    let key = if attempt == 0 { key } else { key.at(attempt) };
    Frames::new(channels, key.normals(frames * channels))
}

/// The start of the coarsest level from the coarsest `examples` and standard normal `noise` of the
/// same length. Source: GenMM; docs/sources/genmm.md.
///
/// # Panics
/// If the channels differ.
pub fn start(examples: &[Frames], noise: &Frames, sigma: f64, start: Start) -> Frames {
    let sigma = sigma as f32;
    let scaled = noise.values().iter().map(|value| sigma * value);
    if start == Start::Noise {
        return Frames::new(noise.channels(), scaled.collect());
    }
    let mut first = Frames::joined(examples).resampled_aligned(noise.frames());
    assert_eq!(first.channels(), noise.channels());
    if sigma > 0.0 {
        // The remainder has the sign of the sum.
        let values = first.values_mut().iter_mut().zip(scaled);
        values.for_each(|(value, noise)| *value = (*value + noise) % 1.0);
    }
    first
}

/// One step: matching against `search` over the patches of `pool`, then voting. `bent`: true for
/// each blended frame, from [`Constraint::apply_all`].
///
/// # Panics
/// As [`Search::nearest`].
pub fn step(
    current: &Frames,
    pool: &Pool,
    search: &mut Search<'_>,
    alpha: Option<f64>,
    looping: Looping,
    bent: &[bool],
) -> (Frames, Matches) {
    let p = pool.patch_size;
    if looping == Looping::Off {
        let matches = search.nearest(current, alpha, bent);
        return (vote(pool, &matches.nearest), matches);
    }
    let (n, half) = (bent.len(), p / 2);
    let ends = if n > 0 { n + 2 * half } else { 0 };
    let bent: Vec<bool> = (0..ends).map(|t| bent[(t + n - half % n) % n]).collect();
    let matches = search.nearest(&pad_loop(current, p), alpha, &bent);
    let voted = match looping {
        Looping::Even => vote_loop(pool, &matches.nearest),
        _ => unpad_loop(&vote(pool, &matches.nearest), p),
    };
    (voted, matches)
}

/// Synthesises a motion from the noise of `seed`. The result does not depend on the number of
/// threads.
///
/// # Errors
/// Fails for settings out of range, an example or motion shorter than a patch, and without
/// examples.
///
/// # Panics
/// If the channels of examples, groups or constraints do not fit.
pub fn synthesize(request: &Request<'_>, seed: u64) -> Result<Synthesis, InvalidSetting> {
    let first = request.levels()?.synthesis[0];
    let noise = start_noise(seed, 0, first, request.examples[0].channels());
    synthesize_from(request, &noise)
}

/// [`synthesize`] from standard normal `noise` as long as the coarsest level.
///
/// # Errors
/// As [`synthesize`]. Panics as well if the noise has another length.
pub fn synthesize_from(request: &Request<'_>, noise: &Frames) -> Result<Synthesis, InvalidSetting> {
    refined(request, |examples, length| {
        assert_eq!(noise.frames(), length, "frames of noise");
        let settings = request.settings;
        start(examples, noise, settings.sigma, settings.start)
    })
}

/// [`synthesize`] from the coarse level of `content` in place of noise: `content` in the style of
/// the examples.
///
/// # Errors
/// As [`synthesize`]. Panics as well if the content has other channels.
pub fn synthesize_like(
    request: &Request<'_>,
    content: &Frames,
) -> Result<Synthesis, InvalidSetting> {
    refined(request, |examples, length| {
        assert_eq!(content.channels(), examples[0].channels());
        content.resampled(length)
    })
}

/// Refines a coarse start at every level. `coarsest` makes the start from the coarsest examples.
fn refined(
    request: &Request<'_>,
    coarsest: impl Fn(&[Frames], usize) -> Frames + Sync,
) -> Result<Synthesis, InvalidSetting> {
    let levels = request.levels()?;
    let settings = request.settings;
    let (looping, is_loop) = (settings.looping, settings.looping != Looping::Off);
    let channels = request.examples[0].channels();
    let body = [Channels {
        name: "body".to_string(),
        channels: (0..channels).collect(),
    }];
    let groups = match request.groups {
        [] => &body[..],
        groups => groups,
    };
    // Runs on a thread of the pool: from outside, each of many short loops would wait to be
    // scheduled.
    Ok(rayon::scope(|_| {
        let mut current: Option<Frames> = None;
        let mut origins = Vec::new();
        for (level, &length) in levels.synthesis.iter().enumerate() {
            let examples = request.examples.iter().zip(&levels.examples);
            let examples = examples.map(|(example, lengths)| example.resampled(lengths[level]));
            let examples: Vec<Frames> = examples.collect();
            let mut frames = match current {
                None => coarsest(&examples, length),
                Some(coarser) if looping == Looping::Even => coarser.resampled_loop(length),
                Some(coarser) => coarser.resampled(length),
            };
            let bent = Constraint::apply_all(request.constraints, &mut frames, is_loop);
            let pools = groups.iter().map(|group| {
                let own = |example: &Frames| group.of(example).into_owned();
                let own: Vec<Frames> = examples.iter().map(own).collect();
                Pool::new(&own, settings.patch_size)
            });
            let pools: Vec<Pool> = pools.collect();
            let search = |pool| {
                let search = Search::new(pool, settings.distance).among(pools.len());
                search.continuing(settings.continuity)
            };
            let mut searches: Vec<Search<'_>> = pools.iter().map(search).collect();
            for _ in 0..settings.num_steps {
                let voted = groups.iter().zip(pools.iter().zip(&mut searches));
                let (voted, matches): (Vec<Frames>, Vec<Matches>) = voted
                    .map(|(group, (pool, search))| {
                        let own = group.of(&frames);
                        step(&own, pool, search, settings.alpha, looping, &bent)
                    })
                    .unzip();
                frames = merged(groups, voted, channels);
                Constraint::apply_all(request.constraints, &mut frames, is_loop);
                let found = matches.iter().zip(&pools);
                let found = found.map(|(matches, pool)| origins_of(matches, pool, length, is_loop));
                origins = found.collect();
            }
            current = Some(frames);
        }
        Synthesis {
            frames: current.expect("a level"),
            origins,
        }
    }))
}

/// Merges the motions of groups; shared channels are averaged.
fn merged(groups: &[Channels], mut voted: Vec<Frames>, channels: usize) -> Frames {
    if let [group] = groups
        && group.are_all(channels)
    {
        return voted.remove(0);
    }
    let mut counts = vec![0.0f32; channels];
    for channel in groups.iter().flat_map(|group| &group.channels) {
        counts[*channel] += 1.0;
    }
    let mut merged = Frames::zeros(voted[0].frames(), channels);
    for (group, frames) in groups.iter().zip(voted) {
        for t in 0..frames.frames() {
            let row = merged.frame_mut(t);
            for (&channel, value) in group.channels.iter().zip(frames.frame(t)) {
                row[channel] += value;
            }
        }
    }
    for row in merged.values_mut().chunks_exact_mut(channels) {
        for (value, count) in row.iter_mut().zip(&counts) {
            *value /= count.max(1.0);
        }
    }
    merged
}

/// The example and frame that each frame continues: its place in the patch around it.
fn origins_of(matches: &Matches, pool: &Pool, frames: usize, is_loop: bool) -> Vec<(usize, usize)> {
    let half = pool.patch_size / 2;
    let last = matches.nearest.len() - 1;
    let origin = |t: usize| {
        // A loop has a patch around every frame, the first around frame 0.
        let patch = match is_loop {
            true => t,
            false => t.saturating_sub(half).min(last),
        };
        let within = if is_loop { half } else { t - patch };
        let (example, first) = pool.origin(matches.nearest[patch]);
        (example, first + within)
    };
    (0..frames).map(origin).collect()
}

#[cfg(test)]
mod tests;
