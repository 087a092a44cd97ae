//! Distances between frames: the sum of squared differences over all channels.

use pulp::{Arch, Simd, WithSimd};

use crate::Frames;

/// Channels are filled up with zeros to a multiple of this: what the widest register holds.
const LANES: usize = 16;
/// Frames of both sides whose distances are summed at a time, so that each is loaded once for all.
const ROWS: usize = 2;
const COLUMNS: usize = 4;

/// Frames whose channels are filled up with zeros, so that registers are always full.
pub(crate) struct Padded {
    stride: usize,
    values: Vec<f32>,
}

impl Padded {
    pub(crate) fn new(frames: &Frames) -> Self {
        let stride = frames.channels().next_multiple_of(LANES);
        let mut values = vec![0.0; frames.frames() * stride];
        for (t, row) in values.chunks_exact_mut(stride).enumerate() {
            row[..frames.channels()].copy_from_slice(frames.frame(t));
        }
        Self { stride, values }
    }

    pub(crate) fn frames(&self) -> usize {
        self.values.len() / self.stride
    }
}

/// Fills `out`, `[rows, y]`, with the squared distances of the frames of `x` from number `first` on
/// to those of `y`. A distance is summed in the same order wherever it stands.
pub(crate) fn squared(x: &Padded, first: usize, y: &Padded, out: &mut [f32]) {
    assert_eq!(x.stride, y.stride);
    let rows = out.len() / y.frames();
    let x = &x.values[first * x.stride..(first + rows) * x.stride];
    Arch::new().dispatch(Squared { x, y, out });
}

struct Squared<'a> {
    x: &'a [f32],
    y: &'a Padded,
    out: &'a mut [f32],
}

impl WithSimd for Squared<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { x, y, out } = self;
        let width = y.frames();
        let stride = y.stride;
        // Blocks of `y` stay in the fastest cache while all of `x` passes by.
        for (block, columns) in y.values.chunks(COLUMNS * stride).enumerate() {
            let at = block * COLUMNS;
            let whole = columns.len() == COLUMNS * stride;
            for (pair, rows) in x.chunks(ROWS * stride).enumerate() {
                let out = &mut out[pair * ROWS * width + at..];
                if whole && rows.len() == ROWS * stride {
                    let sums = tile::<S, ROWS, COLUMNS>(simd, rows, columns, stride);
                    for (row, sums) in sums.iter().enumerate() {
                        out[row * width..row * width + COLUMNS].copy_from_slice(sums);
                    }
                    continue;
                }
                for (row, a) in rows.chunks_exact(stride).enumerate() {
                    for (column, b) in columns.chunks_exact(stride).enumerate() {
                        let [[sum]] = tile::<S, 1, 1>(simd, a, b, stride);
                        out[row * width + column] = sum;
                    }
                }
            }
        }
    }
}

/// The squared distances of R frames to C frames.
#[inline(always)]
fn tile<S: Simd, const R: usize, const C: usize>(
    simd: S,
    rows: &[f32],
    columns: &[f32],
    stride: usize,
) -> [[f32; C]; R] {
    // Loops, not closures: those would be compiled without the instruction set and called.
    let mut a: [&[S::f32s]; R] = [&[]; R];
    for (r, row) in rows.chunks_exact(stride).enumerate() {
        a[r] = S::as_simd_f32s(row).0;
    }
    let mut b: [&[S::f32s]; C] = [&[]; C];
    for (c, column) in columns.chunks_exact(stride).enumerate() {
        b[c] = S::as_simd_f32s(column).0;
    }
    let mut sums = [[simd.splat_f32s(0.0); C]; R];
    for k in 0..a[0].len() {
        for r in 0..R {
            for c in 0..C {
                let apart = simd.sub_f32s(a[r][k], b[c][k]);
                sums[r][c] = simd.mul_add_f32s(apart, apart, sums[r][c]);
            }
        }
    }
    let mut found = [[0.0; C]; R];
    for r in 0..R {
        for c in 0..C {
            found[r][c] = simd.reduce_sum_f32s(sums[r][c]);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn they_are_those_of_the_definition(
            n in 1..9usize,
            m in 1..14usize,
            channels in 1..40usize,
            seed in 0..1000u64,
        ) {
            let of = |frames: usize, side| {
                let key = Key::new(seed, Purpose::Matching).at(side);
                Frames::new(channels, key.normals(frames * channels))
            };
            let (x, y) = (of(n, 0), of(m, 1));
            for first in 0..n {
                let mut found = vec![f32::NAN; (n - first) * m];
                squared(&Padded::new(&x), first, &Padded::new(&y), &mut found);
                for (index, found) in found.iter().enumerate() {
                    let pairs = x.frame(first + index / m).iter().zip(y.frame(index % m));
                    let exact = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                    prop_assert!((f64::from(*found) - exact).abs() < 1e-5 * exact.max(1.0));
                }
            }
        }
    }
}
