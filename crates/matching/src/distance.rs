//! Squared distances of frames.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::Frames;

/// Channels are padded to a multiple of the widest register.
const LANES: usize = 16;
/// Rows of the block of frame pairs that is loaded once; the registers hold the block's sums.
const ROWS: usize = 2;
const MORE_ROWS: usize = 4;
const COLUMNS: usize = 4;
/// Bytes of `y` that stay in the fastest cache while all of `x` is read.
const BLOCK: usize = 16 << 10;

/// Largest deviation of a constant channel, relative to values of 1: the precision of angles
/// written as text.
const STRAY: f32 = 1e-6;

/// The channels of examples, split into moving and constant ones. Constant channels, such as
/// fingers, add the same sum to all distances of a frame.
pub(crate) struct Moving {
    moving: Vec<usize>,
    /// Constant channels with their values.
    still: Vec<(usize, f32)>,
}

impl Moving {
    pub(crate) fn of(examples: &Frames) -> Self {
        let mut low = examples.frame(0).to_vec();
        let mut high = low.clone();
        for row in examples.values().chunks_exact(examples.channels()) {
            for ((low, high), value) in low.iter_mut().zip(&mut high).zip(row) {
                (*low, *high) = (low.min(*value), high.max(*value));
            }
        }
        let stands = |&c: &usize| high[c] - low[c] <= STRAY * high[c].abs().max(1.0);
        // At least one channel moves, for the layout.
        let (still, moving): (Vec<usize>, Vec<usize>) =
            (1..examples.channels()).partition(|c| stands(c));
        let still = still.into_iter().map(|c| (c, 0.5 * (low[c] + high[c])));
        Self {
            moving: [0].into_iter().chain(moving).collect(),
            still: still.collect(),
        }
    }

    /// Frames of the same channels in the layout of [`squared`].
    pub(crate) fn padded(&self, frames: &Frames) -> Padded {
        let stride = self.moving.len().next_multiple_of(LANES);
        let values = vec![0.0; frames.frames() * stride + LANES];
        // A register that spans two cache lines is loaded twice.
        let first = values.as_ptr().align_offset(size_of::<f32>() * LANES);
        let mut padded = Padded {
            stride,
            values,
            first: if first < LANES { first } else { 0 },
            still: vec![0.0; frames.frames()],
        };
        self.renew(&mut padded, frames);
        padded
    }

    /// Replaces the frames of `padded` by equally many `frames`; returns true for each frame that
    /// changed.
    pub(crate) fn renew(&self, padded: &mut Padded, frames: &Frames) -> Vec<bool> {
        let (stride, first) = (padded.stride, padded.first);
        let values = &mut padded.values[first..first + frames.frames() * stride];
        let rows = values
            .par_chunks_exact_mut(stride)
            .zip(&mut padded.still)
            .enumerate();
        let changed = rows.map(|(t, (row, still))| {
            let frame = frames.frame(t);
            let mut changed = 0;
            for (value, &channel) in row.iter_mut().zip(&self.moving) {
                let before = std::mem::replace(value, frame[channel]);
                changed |= before.to_bits() ^ value.to_bits();
            }
            // Independent sums.
            let mut sums = [0.0; 8];
            for still in self.still.chunks(sums.len()) {
                for (sum, &(channel, constant)) in sums.iter_mut().zip(still) {
                    *sum += (frame[channel] - constant).powi(2);
                }
            }
            let before = std::mem::replace(still, sums.iter().sum());
            changed != 0 || *still != before
        });
        changed.collect()
    }
}

/// Frames with their moving channels padded by zeros.
pub(crate) struct Padded {
    stride: usize,
    values: Vec<f32>,
    /// Offset of the first frame.
    first: usize,
    /// Squared distance of each frame to any example frame in the constant channels.
    pub(crate) still: Vec<f32>,
}

impl Padded {
    /// Frames with all channels compared.
    pub(crate) fn all_channels(frames: &Frames) -> Self {
        let all = Moving {
            moving: (0..frames.channels()).collect(),
            still: Vec::new(),
        };
        all.padded(frames)
    }

    pub(crate) fn frames(&self) -> usize {
        self.still.len()
    }

    /// `frames` frames from `first` on.
    fn rows(&self, first: usize, frames: usize) -> &[f32] {
        let begin = self.first + first * self.stride;
        &self.values[begin..begin + frames * self.stride]
    }
}

/// Fills `out`, `[rows, y]`, with the squared distances of the frames of `x` from `first` on to
/// those of `y` in the moving channels. The order of summation does not depend on the position.
pub(crate) fn squared(x: &Padded, first: usize, y: &Padded, out: &mut [f32]) {
    assert_eq!(x.stride, y.stride);
    let rows = out.len() / y.frames();
    let x = x.rows(first, rows);
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
        // Sixteen sums, four frames and a difference need more than sixteen registers.
        if S::REGISTER_COUNT >= 32 {
            self.fill::<S, MORE_ROWS>(simd);
        } else {
            self.fill::<S, ROWS>(simd);
        }
    }
}

impl Squared<'_> {
    #[inline(always)]
    fn fill<S: Simd, const R: usize>(self, simd: S) {
        let Self { x, y, out } = self;
        let width = y.frames();
        let stride = y.stride;
        let block = BLOCK / size_of::<f32>() / stride;
        let block = block.next_multiple_of(COLUMNS).max(COLUMNS);
        for (number, columns) in y.rows(0, width).chunks(block * stride).enumerate() {
            for (group, rows) in x.chunks(R * stride).enumerate() {
                for (part, columns) in columns.chunks(COLUMNS * stride).enumerate() {
                    let at = number * block + part * COLUMNS;
                    let out = &mut out[group * R * width + at..];
                    if columns.len() == COLUMNS * stride && rows.len() == R * stride {
                        let sums = tile::<S, R, COLUMNS>(simd, rows, columns, stride);
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
}

/// Squared distances of R frames to C frames.
#[inline(always)]
fn tile<S: Simd, const R: usize, const C: usize>(
    simd: S,
    rows: &[f32],
    columns: &[f32],
    stride: usize,
) -> [[f32; C]; R] {
    // Loops, because closures would be compiled without the instruction set.
    let mut a: [&[S::f32s]; R] = [&[]; R];
    for (r, row) in rows.chunks_exact(stride).enumerate() {
        a[r] = S::as_simd_f32s(row).0;
    }
    let mut b: [&[S::f32s]; C] = [&[]; C];
    for (c, column) in columns.chunks_exact(stride).enumerate() {
        b[c] = S::as_simd_f32s(column).0;
    }
    // Equal lengths remove bounds checks.
    let registers = a[0].len();
    for row in a.iter_mut().chain(&mut b) {
        *row = &row[..registers];
    }
    let mut sums = [[simd.splat_f32s(0.0); C]; R];
    for k in 0..registers {
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
            let (x, mut y) = (of(n, 0), of(m, 1));
            // Every third channel of the example is constant, except for the last bits.
            for (at, value) in y.values_mut().iter_mut().enumerate() {
                if (at % channels).is_multiple_of(3) {
                    *value = 0.4 + 1e-7 * value.clamp(-1.0, 1.0);
                }
            }
            for first in 0..n {
                let mut found = vec![f32::NAN; (n - first) * m];
                let moving = Moving::of(&y);
                let x_padded = moving.padded(&x);
                squared(&x_padded, first, &moving.padded(&y), &mut found);
                for (index, found) in found.iter().enumerate() {
                    let found = found + x_padded.still[first + index / m];
                    let pairs = x.frame(first + index / m).iter().zip(y.frame(index % m));
                    let exact = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                    prop_assert!((f64::from(found) - exact).abs() < 1e-5 * exact.max(1.0));
                }
            }
        }
    }
}
