//! Energy of the twelve pitch classes.

use crate::FrameMatrix;
use crate::cqt::BINS_PER_OCTAVE;

/// Pitch classes, C first.
pub const CLASSES: usize = 12;

const BINS_PER_SEMITONE: usize = BINS_PER_OCTAVE / CLASSES;

/// Sums the bins of each pitch class: three bins centred on each semitone.
///
/// # Shapes
/// `cqt`: `[T, 252]`; result: `[T, 12]`.
pub fn fold(cqt: &FrameMatrix) -> FrameMatrix {
    let mut out = FrameMatrix::zeros(cqt.frames(), CLASSES);
    for (t, row) in out.as_mut_slice().chunks_exact_mut(CLASSES).enumerate() {
        for (k, magnitude) in cqt.frame(t).iter().enumerate() {
            row[(k + 1) / BINS_PER_SEMITONE % CLASSES] += magnitude;
        }
    }
    out
}

/// Divides each frame by its maximum; a frame of zeros stays zero. `[T, 12]`.
pub fn normalise(mut chroma: FrameMatrix) -> FrameMatrix {
    for row in chroma.as_mut_slice().chunks_exact_mut(CLASSES) {
        let maximum = row.iter().copied().fold(0.0, f32::max);
        if maximum >= f32::MIN_POSITIVE {
            row.iter_mut().for_each(|value| *value /= maximum);
        }
    }
    chroma
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_bins_around_a_semitone_make_its_class() {
        let mut cqt = FrameMatrix::zeros(2, 252);
        for (k, value) in [(0, 1.0), (1, 2.0), (2, 4.0), (35, 8.0), (36, 16.0)] {
            cqt.as_mut_slice()[k] = value;
        }
        let chroma = fold(&cqt);
        assert_eq!(chroma.frame(0)[..3], [27.0, 4.0, 0.0]);
        let scaled = normalise(chroma);
        assert_eq!(scaled.frame(0)[0], 1.0);
        assert_eq!(scaled.frame(1), [0.0; CLASSES]);
    }
}
