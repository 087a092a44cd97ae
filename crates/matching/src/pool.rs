//! The patches of all examples at one level.

use std::ops::Range;

use crate::Frames;

/// The frames of all examples at one level, joined. A patch is `patch_size` consecutive frames of
/// one example; patches are numbered through all examples.
#[derive(Clone, Debug)]
pub struct Pool {
    /// All frames, `[frames, channels]`.
    pub frames: Frames,
    /// Frames of a patch.
    pub patch_size: usize,
    /// Number of patches.
    pub patches: usize,
    examples: Vec<Range<usize>>,
    /// Number of each example's first patch.
    first_patches: Vec<usize>,
}

impl Pool {
    /// The patches of the examples, `patch_size` frames each. Shorter examples have none.
    ///
    /// # Panics
    /// Panics if there are no examples, or their channels differ.
    pub fn new(examples: &[Frames], patch_size: usize) -> Self {
        let mut ranges = Vec::with_capacity(examples.len());
        let mut first_patches = Vec::with_capacity(examples.len());
        let (mut start, mut patches) = (0, 0);
        for example in examples {
            ranges.push(start..start + example.frames());
            first_patches.push(patches);
            start += example.frames();
            patches += (example.frames() + 1).saturating_sub(patch_size);
        }
        Self {
            frames: Frames::joined(examples),
            examples: ranges,
            patch_size,
            first_patches,
            patches,
        }
    }

    /// Runs of consecutive patches: number of the first, its first frame in the pool, and their
    /// count.
    pub fn runs(&self) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let examples = self.examples.iter().zip(&self.first_patches);
        examples.filter_map(|(example, &first)| {
            let patches = (example.len() + 1).checked_sub(self.patch_size)?;
            (patches > 0).then_some((first, example.start, patches))
        })
    }

    /// The example of a patch, and its first frame there.
    ///
    /// # Panics
    /// Panics if there is no such patch.
    pub fn origin(&self, patch: usize) -> (usize, usize) {
        assert!(patch < self.patches);
        let example = self.first_patches.partition_point(|&first| first <= patch) - 1;
        // Examples without patches begin at the same number as the next example.
        (example, patch - self.first_patches[example])
    }

    /// The first frame of a patch in the pool. It panics like [`origin`](Self::origin).
    pub fn start(&self, patch: usize) -> usize {
        let (example, frame) = self.origin(patch);
        self.examples[example].start + frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_never_span_two_examples() {
        let lengths = [7, 3, 5];
        let examples = lengths.map(|frames| Frames::zeros(frames, 2));
        let pool = Pool::new(&examples, 5);
        assert_eq!(pool.patches, 4);
        let origins: Vec<_> = (0..4).map(|patch| pool.origin(patch)).collect();
        assert_eq!(origins, [(0, 0), (0, 1), (0, 2), (2, 0)]);
        assert_eq!(pool.start(3), 10);
        let runs: Vec<_> = pool.runs().collect();
        assert_eq!(runs, [(0, 0, 3), (3, 10, 1)]);
    }
}
