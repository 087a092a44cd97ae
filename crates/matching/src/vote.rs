//! Voting: every frame is the mean of the selected patches that cover it.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::{Frames, Pool};

/// The motion of `nearest.len() + patch_size - 1` frames whose patch i is the example patch
/// `nearest[i]`, `[frames, channels]`. A frame is the mean of the patches that cover it.
///
/// # Panics
/// If `nearest` is empty or names no patch of `pool`.
pub fn vote(pool: &Pool, nearest: &[usize]) -> Frames {
    let p = pool.patch_size;
    means(pool, nearest, nearest.len() + p - 1, |starts, t, frame| {
        let covering = t.saturating_sub(p - 1)..(t + 1).min(starts.len());
        mean(pool, covering.map(|i| starts[i] + t - i), frame);
    })
}

/// The loop of `nearest.len()` frames in which the example patch `nearest[i]` is centred on frame
/// i, `[frames, channels]`: every frame is the mean of the `patch_size` patches that cover it.
///
/// # Panics
/// As [`vote`].
pub fn vote_loop(pool: &Pool, nearest: &[usize]) -> Frames {
    let (p, n) = (pool.patch_size, nearest.len());
    means(pool, nearest, n, |starts, t, frame| {
        // The patch with this frame at `within`; a short motion wraps twice.
        let patch = |within: usize| (t + p / 2 + (p / n + 1) * n - within) % n;
        let sources = (0..p).map(|within| starts[patch(within)] + within);
        mean(pool, sources, frame);
    })
}

/// `frames` frames, each filled by `fill` from the first pool frames of the `nearest` patches.
fn means(
    pool: &Pool,
    nearest: &[usize],
    frames: usize,
    fill: impl Fn(&[usize], usize, &mut [f32]) + Sync,
) -> Frames {
    let channels = pool.frames.channels();
    let starts: Vec<usize> = nearest.iter().map(|&patch| pool.start(patch)).collect();
    let mut voted = Frames::zeros(frames, channels);
    let rows = voted.values_mut().par_chunks_exact_mut(channels);
    let fill = |(t, frame): (usize, &mut [f32])| fill(&starts, t, frame);
    rows.enumerate().for_each(fill);
    voted
}

/// Adds the mean of the pool frames `sources` to `frame`, which is zero.
fn mean(pool: &Pool, sources: impl ExactSizeIterator<Item = usize>, frame: &mut [f32]) {
    let count = sources.len() as f32;
    let mut sources = sources.peekable();
    while let Some(source) = sources.next() {
        // Consecutive patches share this frame.
        let mut same = 1.0;
        while sources.next_if_eq(&source).is_some() {
            same += 1.0;
        }
        Arch::new().dispatch(Add {
            values: pool.frames.frame(source),
            weight: same / count,
            sums: frame,
        });
    }
}

/// Adds weighted values.
struct Add<'a> {
    values: &'a [f32],
    weight: f32,
    sums: &'a mut [f32],
}

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (sum, value) in self.sums.iter_mut().zip(self.values) {
            *sum += self.weight * value;
        }
    }
}

/// A loop padded by `patch_size / 2` frames of the other end on both sides, so that patches span
/// the seam.
pub fn pad_loop(frames: &Frames, patch_size: usize) -> Frames {
    let (n, half) = (frames.frames(), patch_size / 2);
    let wrapped = (0..n + 2 * half).flat_map(|t| frames.frame((t + n - half % n) % n));
    Frames::new(frames.channels(), wrapped.copied().collect())
}

/// Inverse of [`pad_loop`] after voting: the first and last `patch_size / 2` frames are averaged
/// with their copies at the other end.
pub fn unpad_loop(padded: &Frames, patch_size: usize) -> Frames {
    let half = patch_size / 2;
    let (n, channels) = (padded.frames() - 2 * half, padded.channels());
    let inner = &padded.values()[half * channels..(half + n) * channels];
    let mut frames = Frames::new(channels, inner.to_vec());
    let mut average = |t: usize, copy: usize| {
        let pairs = frames.frame_mut(t).iter_mut().zip(padded.frame(copy));
        pairs.for_each(|(value, copy)| *value = (*value + copy) / 2.0);
    };
    for k in 0..half {
        average(k, half + n + k);
        average(n - half + k, k);
    }
    frames
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn numbered(frames: usize) -> Frames {
        Frames::new(1, (0..frames).map(|t| t as f32).collect())
    }

    proptest! {
        #[test]
        fn patches_in_their_own_place_give_the_example_back(
            frames in 9..40usize,
            half in 0..5usize,
        ) {
            let example = numbered(frames);
            let pool = Pool::new(std::slice::from_ref(&example), 2 * half + 1);
            let own: Vec<usize> = (0..pool.patches).collect();
            prop_assert_eq!(&vote(&pool, &own), &example);
        }

        #[test]
        fn ends_come_and_go(frames in 9..40usize, half in 0..5usize) {
            let motion = numbered(frames);
            let padded = pad_loop(&motion, 2 * half + 1);
            prop_assert_eq!(padded.frames(), frames + 2 * half);
            prop_assert_eq!(padded.frame(half), motion.frame(0));
            if half > 0 {
                prop_assert_eq!(padded.frame(0), motion.frame(frames - half));
                prop_assert_eq!(padded.frame(frames + half), motion.frame(0));
            }
            prop_assert_eq!(&unpad_loop(&padded, 2 * half + 1), &motion);
        }
    }

    #[test]
    fn around_the_circle_every_frame_has_a_whole_patch_of_votes() {
        let pool = Pool::new(&[numbered(6)], 3);
        // Patches 0 1 2, 3 4 5, 2 3 4 and 1 2 3 around frames 0 to 3.
        let voted = vote_loop(&pool, &[0, 3, 2, 1]);
        let thirds = voted.values().iter().map(|value| (3.0 * value).round());
        assert!(thirds.eq([
            1.0 + 3.0 + 3.0,
            2.0 + 4.0 + 2.0,
            5.0 + 3.0 + 1.0,
            4.0 + 2.0 + 0.0
        ]));
    }

    #[test]
    fn a_frame_is_the_mean_of_what_covers_it() {
        let pool = Pool::new(&[numbered(6)], 3);
        // Patches 0 1 2, 3 4 5 and 2 3 4.
        let voted = vote(&pool, &[0, 3, 2]);
        assert_eq!(voted.values(), [0.0, 2.0, 8.0 / 3.0, 4.0, 4.0]);
    }
}
