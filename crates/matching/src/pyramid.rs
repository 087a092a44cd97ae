//! Lengths of the pyramid levels.

/// Level lengths of a motion of `frames` frames, the coarsest first: `frames * coarse_ratio`, then
/// each `1 / pyr_factor` times as long, rounded half to even and strictly increasing, up to
/// `frames`. A ratio of 1 or more gives one level. Source: GenMM; docs/sources/genmm.md.
pub fn pyramid_lengths(frames: usize, coarse_ratio: f64, pyr_factor: f64) -> Vec<usize> {
    let rounded = |value: f64| value.round_ties_even() as usize;
    let mut lengths = vec![rounded(frames as f64 * coarse_ratio)];
    while let Some(&last) = lengths.last()
        && last < frames
    {
        let next = rounded(last as f64 / pyr_factor);
        lengths.push(if next <= last { last + 1 } else { next });
    }
    *lengths.last_mut().expect("one at least") = frames;
    lengths
}

/// Lengths of all motions at every level.
#[derive(Clone, Debug, PartialEq)]
pub struct Levels {
    /// `[examples][levels]`, the coarsest level first.
    pub examples: Vec<Vec<usize>>,
    /// `[levels]`.
    pub synthesis: Vec<usize>,
}

impl Levels {
    /// The levels for examples and a result of these lengths.
    ///
    /// The example with the fewest levels determines the number of levels; levels without a patch
    /// are dropped. If rounding gives the synthesis another number, the synthesis has lengths
    /// proportional to those of the longest example, at least a patch.
    ///
    /// # Panics
    /// Panics if there are no examples.
    pub fn new(
        examples: &[usize],
        synthesis: usize,
        coarse_ratio: f64,
        pyr_factor: f64,
        patch_size: usize,
    ) -> Self {
        let lengths = |frames| pyramid_lengths(frames, coarse_ratio, pyr_factor);
        let mut all: Vec<Vec<usize>> = examples.iter().map(|&frames| lengths(frames)).collect();
        let mut levels = all.iter().map(Vec::len).min().expect("an example");
        let has_patch = |level: usize| {
            let mut lengths = all.iter().map(|lengths| lengths[lengths.len() - level]);
            lengths.any(|length| length >= patch_size)
        };
        while levels > 1 && !has_patch(levels) {
            levels -= 1;
        }
        for lengths in &mut all {
            lengths.drain(..lengths.len() - levels);
        }
        let mut own = lengths(synthesis);
        if own.len() != levels {
            let longest = all.iter().max_by_key(|lengths| lengths[levels - 1]);
            let longest = longest.expect("an example");
            let scale = synthesis as f64 / longest[levels - 1] as f64;
            let scaled = |length: &usize| (*length as f64 * scale).round_ties_even() as usize;
            own = longest.iter().map(scaled).collect();
        }
        for length in &mut own {
            *length = (*length).max(patch_size.min(synthesis));
        }
        Self {
            examples: all,
            synthesis: own,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn lengths_grow_to_the_end(
            frames in 1..3000usize,
            ratio in 0.01..1.5f64,
            factor in 0.3..0.99f64,
        ) {
            let lengths = pyramid_lengths(frames, ratio, factor);
            prop_assert_eq!(*lengths.last().unwrap(), frames);
            prop_assert!(lengths.windows(2).all(|pair| pair[0] < pair[1]));
        }

        #[test]
        fn all_have_one_number_of_levels(
            examples in proptest::collection::vec(11..900usize, 1..5),
            synthesis in 11..2000usize,
            patches in 0.05..8.0f64,
            factor in 0.5..0.9f64,
        ) {
            let longest = *examples.iter().max().unwrap();
            let ratio = 11.0 * patches / longest as f64;
            let levels = Levels::new(&examples, synthesis, ratio, factor, 11);
            for (lengths, frames) in levels.examples.iter().zip(&examples) {
                prop_assert_eq!(lengths.len(), levels.synthesis.len());
                prop_assert_eq!(lengths.last(), Some(frames));
            }
            for level in 0..levels.synthesis.len() {
                prop_assert!(levels.examples.iter().any(|lengths| lengths[level] >= 11));
            }
            prop_assert_eq!(levels.synthesis.last(), Some(&synthesis));
            prop_assert!(levels.synthesis.iter().all(|&length| length >= 11));
            prop_assert!(levels.synthesis.is_sorted());
        }
    }
}
