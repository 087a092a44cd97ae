//! Distances between frames: the sum of squared differences over all channels.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::Frames;

/// Channels are filled up with zeros to a multiple of this: what the widest register holds.
const LANES: usize = 16;
/// Frames of both sides whose distances are summed at a time, so that each is loaded once for all:
/// as many sums as there are registers for.
const ROWS: usize = 2;
const MORE_ROWS: usize = 4;
const COLUMNS: usize = 4;
/// Bytes of `y` that stay in the fastest cache while all of `x` passes by.
const BLOCK: usize = 16 << 10;

/// How far a channel that stands still may stray, beside values of 1: what angles written as text lose.
const STRAY: f32 = 1e-6;

/// The channels of examples, by whether they move. Those that stand still, as fingers often do, add the
/// same to the distances of a frame to all example frames, which is summed once.
pub(crate) struct Moving {
    moving: Vec<usize>,
    /// With the value that the channel keeps to.
    still: Vec<(usize, f32)>,
}

impl Moving {
    /// The channels of `examples`.
    pub(crate) fn of(examples: &Frames) -> Self {
        let mut low = examples.frame(0).to_vec();
        let mut high = low.clone();
        for row in examples.values().chunks_exact(examples.channels()) {
            for ((low, high), value) in low.iter_mut().zip(&mut high).zip(row) {
                (*low, *high) = (low.min(*value), high.max(*value));
            }
        }
        let stands = |&c: &usize| high[c] - low[c] <= STRAY * high[c].abs().max(1.0);
        // At least one is compared, or there would be nothing to lay out.
        let (still, moving): (Vec<usize>, Vec<usize>) =
            (1..examples.channels()).partition(|c| stands(c));
        Self {
            moving: [0].into_iter().chain(moving).collect(),
            still: still
                .into_iter()
                .map(|c| (c, 0.5 * (low[c] + high[c])))
                .collect(),
        }
    }

    /// Frames of the same channels, laid out for [`squared`].
    pub(crate) fn padded(&self, frames: &Frames) -> Padded {
        let stride = self.moving.len().next_multiple_of(LANES);
        let values = vec![0.0; frames.frames() * stride + LANES];
        // Registers that lie across two lines of a cache are read twice.
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

    /// Puts `frames`, as many as are there, in place of those of `padded`. Says of each whether it is
    /// another one than before.
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
            // Several sums, none of which waits for the one before.
            let mut sums = [0.0; 8];
            for still in self.still.chunks(sums.len()) {
                for (sum, &(channel, kept)) in sums.iter_mut().zip(still) {
                    *sum += (frame[channel] - kept).powi(2);
                }
            }
            let before = std::mem::replace(still, sums.iter().sum());
            changed != 0 || *still != before
        });
        changed.collect()
    }
}

/// Frames whose moving channels are filled up with zeros, so that registers are always full.
pub(crate) struct Padded {
    stride: usize,
    values: Vec<f32>,
    /// Where the first frame begins.
    first: usize,
    /// Of each frame the squared distance in the channels that stand still.
    still: Vec<f32>,
}

impl Padded {
    /// Frames of which all channels are compared.
    pub(crate) fn whole(frames: &Frames) -> Self {
        let all = Moving {
            moving: (0..frames.channels()).collect(),
            still: Vec::new(),
        };
        all.padded(frames)
    }

    pub(crate) fn frames(&self) -> usize {
        self.still.len()
    }

    /// The squared distance of each frame to any example frame, in the channels that stand still there.
    pub(crate) fn still(&self) -> &[f32] {
        &self.still
    }

    /// `frames` frames from number `first` on.
    fn rows(&self, first: usize, frames: usize) -> &[f32] {
        let begin = self.first + first * self.stride;
        &self.values[begin..begin + frames * self.stride]
    }
}

/// Fills `out`, `[rows, y]`, with the squared distances of the frames of `x` from number `first` on
/// to those of `y`, in the channels that move. A distance is summed in the same order wherever it stands.
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
        // Sixteen sums, four frames and one difference need more registers than sixteen.
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
    // Of one length for the compiler too, which then checks no place.
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
            // Every third channel stands still in the example, but for the last bits.
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
                    let found = found + x_padded.still()[first + index / m];
                    let pairs = x.frame(first + index / m).iter().zip(y.frame(index % m));
                    let exact = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                    prop_assert!((f64::from(found) - exact).abs() < 1e-5 * exact.max(1.0));
                }
            }
        }
    }
}
