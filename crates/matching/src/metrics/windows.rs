//! Distances of windows of a motion to the nearest windows of others.

use rayon::prelude::*;

use crate::Frames;
use crate::distance::{Padded, squared};

/// Windows compared at a time.
const ROWS: usize = 64;
/// Most windows whose distances to all others give the typical distance.
const SPACED: usize = 64;

/// The frames of all targets, joined.
struct ReferenceWindows {
    frames: Padded,
    /// First frame and length of each target.
    ranges: Vec<(usize, usize)>,
}

impl ReferenceWindows {
    fn new(targets: &[Frames]) -> Self {
        let mut start = 0;
        let ranges = targets.iter().map(|target| {
            let range = (start, target.frames());
            start += target.frames();
            range
        });
        Self {
            ranges: ranges.collect(),
            frames: Padded::all_channels(&Frames::joined(targets)),
        }
    }

    /// Distances of `rows` frames from `first` on to all target frames.
    fn distances(&self, motion: &Padded, first: usize, rows: usize) -> Vec<f32> {
        let mut distances = vec![0.0; rows * self.frames.frames()];
        squared(motion, first, &self.frames, &mut distances);
        for distance in &mut distances {
            *distance = distance.sqrt();
        }
        distances
    }
}

/// The distance of each window of `window` frames of `motion` to the nearest window of the targets:
/// the mean distance of their frames. No window spans two targets.
pub(super) fn cheapest(motion: &Frames, targets: &[Frames], window: usize) -> Vec<f64> {
    let targets = ReferenceWindows::new(targets);
    let motion = Padded::all_channels(motion);
    let windows = motion.frames() + 1 - window;
    let width = targets.frames.frames();
    let firsts: Vec<usize> = (0..windows).step_by(ROWS).collect();
    let nearest = |&first: &usize| {
        let rows = ROWS.min(windows - first);
        let distances = targets.distances(&motion, first, rows + window - 1);
        let of = |i: usize| {
            let mut least = f64::INFINITY;
            for &(start, frames) in &targets.ranges {
                for j in start..(start + frames + 1).saturating_sub(window) {
                    let along = (0..window).map(|k| distances[(i + k) * width + j + k]);
                    least = least.min(along.map(f64::from).sum());
                }
            }
            least / window as f64
        };
        (0..rows).map(of).collect::<Vec<_>>()
    };
    firsts.par_iter().flat_map_iter(nearest).collect()
}

/// The median distance of windows of the targets that do not overlap: of evenly spaced windows, at
/// most [`SPACED`], to all others. `None` without such windows.
pub(super) fn typical(targets: &[Frames], window: usize) -> Option<f64> {
    let targets = ReferenceWindows::new(targets);
    let starts = targets.ranges.iter().flat_map(|&(start, frames)| {
        let windows = (frames + 1).saturating_sub(window);
        start..start + windows
    });
    let starts: Vec<usize> = starts.collect();
    let step = starts.len().div_ceil(SPACED).max(1);
    let width = targets.frames.frames();
    let of = |&i: &usize| {
        let distances = targets.distances(&targets.frames, i, window);
        let apart = starts.iter().filter(|&&j| i.abs_diff(j) >= window);
        let along = |&j: &usize| {
            (0..window)
                .map(|k| f64::from(distances[k * width + j + k]))
                .sum()
        };
        apart.map(along).collect::<Vec<f64>>()
    };
    let spaced: Vec<usize> = starts.iter().copied().step_by(step).collect();
    let mut all: Vec<f64> = spaced.par_iter().flat_map_iter(of).collect();
    let middle = all.len() / 2;
    let (_, median, _) =
        (!all.is_empty()).then(|| all.select_nth_unstable_by(middle, f64::total_cmp))?;
    Some(*median / window as f64)
}

/// Mean distance of the frames of `motion` to the targets, minimised over cuts into segments of at
/// least `shortest` frames that each follow a target: G(e) = min over s <= e - shortest of G(s) +
/// the smallest sum for the frames from s to e.
pub(super) fn segmented(motion: &Frames, targets: &[Frames], shortest: usize) -> f64 {
    let targets = ReferenceWindows::new(targets);
    let motion = Padded::all_channels(motion);
    let frames = motion.frames();
    // A segment of twice the shortest length costs no less than its halves.
    let longest = 2 * shortest - 1;
    let width = targets.frames.frames();
    let firsts: Vec<usize> = (0..frames).step_by(ROWS).collect();
    // For each end the smallest sums of segments of `shortest..=longest` frames.
    let sums = |&first: &usize| {
        let before = first.min(longest);
        let rows = ROWS.min(frames - first) + before;
        let distances = targets.distances(&motion, first - before, rows);
        let of = |end: usize| {
            let mut least = vec![f64::INFINITY; longest - shortest + 1];
            for &(start, frames) in &targets.ranges {
                for j in 0..frames {
                    let mut sum = 0.0;
                    for k in 0..longest.min(j + 1).min(end + 1) {
                        sum += f64::from(distances[(end - k) * width + start + j - k]);
                        if k + 1 >= shortest {
                            let least = &mut least[k + 1 - shortest];
                            *least = least.min(sum);
                        }
                    }
                }
            }
            least
        };
        (before..rows).map(of).collect::<Vec<_>>()
    };
    let sums: Vec<Vec<f64>> = firsts.par_iter().flat_map_iter(sums).collect();
    let mut total = vec![f64::INFINITY; frames + 1];
    total[0] = 0.0;
    for end in 1..=frames {
        for (index, sum) in sums[end - 1].iter().enumerate() {
            if let Some(start) = end.checked_sub(shortest + index) {
                total[end] = total[end].min(total[start] + sum);
            }
        }
    }
    total[frames] / frames as f64
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};
    use proptest::prelude::*;

    use super::*;

    fn motion(seed: u64, frames: usize) -> Frames {
        let key = Key::new(seed, Purpose::Matching);
        Frames::new(3, key.normals(3 * frames))
    }

    fn apart(a: &Frames, i: usize, b: &Frames, j: usize) -> f64 {
        let pairs = a.frame(i).iter().zip(b.frame(j));
        pairs
            .map(|(a, b)| f64::from(a - b).powi(2))
            .sum::<f64>()
            .sqrt()
    }

    /// The cheapest sum for the frames from `s` to `e`.
    fn sum(motion: &Frames, targets: &[Frames], s: usize, e: usize) -> f64 {
        let sums = targets.iter().flat_map(|target| {
            let starts = 0..(target.frames() + 1 + s).saturating_sub(e);
            starts.map(move |j| (s..e).map(|i| apart(motion, i, target, j + i - s)).sum())
        });
        sums.fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn windows_and_segments_are_those_of_the_definition(
            seed in 0..1000u64,
            frames in 8..90usize,
            lengths in proptest::collection::vec(6..40usize, 1..3),
            window in 2..6usize,
        ) {
            let motion_frames = motion(seed, frames);
            let targets: Vec<Frames> = lengths
                .iter()
                .enumerate()
                .map(|(index, &frames)| motion(seed + 1 + index as u64, frames))
                .collect();
            let found = cheapest(&motion_frames, &targets, window);
            prop_assert_eq!(found.len(), frames + 1 - window);
            for (i, found) in found.iter().enumerate() {
                let exact = sum(&motion_frames, &targets, i, i + window) / window as f64;
                prop_assert!((found - exact).abs() < 1e-4);
            }
            // All segments, including those longer than twice the shortest.
            let mut total = vec![f64::INFINITY; frames + 1];
            total[0] = 0.0;
            for e in window..=frames {
                for s in 0..=e - window {
                    if total[s].is_finite() {
                        total[e] = f64::min(total[e], total[s] + sum(&motion_frames, &targets, s, e));
                    }
                }
            }
            let found = segmented(&motion_frames, &targets, window);
            // No segments fit if the motion cannot be cut and every target is shorter than the
            // motion.
            let exact = total[frames] / frames as f64;
            prop_assert!(found == exact || (found - exact).abs() < 1e-4);
        }
    }

    #[test]
    fn the_typical_distance_is_the_median_over_windows_apart() {
        let targets = [motion(1, 20), motion(2, 12)];
        let mut all = Vec::new();
        for (a, one) in targets.iter().enumerate() {
            for (b, other) in targets.iter().enumerate() {
                for (i, j) in
                    (0..one.frames() - 4).flat_map(|i| (0..other.frames() - 4).map(move |j| (i, j)))
                {
                    if a != b || usize::abs_diff(i, j) >= 5 {
                        let sum: f64 = (0..5).map(|k| apart(one, i + k, other, j + k)).sum();
                        all.push(sum / 5.0);
                    }
                }
            }
        }
        all.sort_by(f64::total_cmp);
        let median = all[all.len() / 2];
        assert!((typical(&targets, 5).unwrap() - median).abs() < 1e-4);
        assert_eq!(typical(&[motion(1, 9)], 5), None);
    }

    #[test]
    fn a_copy_costs_nothing() {
        let original = motion(1, 80);
        let itself = std::slice::from_ref(&original);
        let costs = cheapest(&original, itself, 30);
        assert!(costs.iter().all(|&cost| cost == 0.0));
        assert_eq!(segmented(&original, itself, 30), 0.0);
    }
}
