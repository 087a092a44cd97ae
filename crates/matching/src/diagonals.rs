//! Patch distances: sums of frame distances along diagonals.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use crate::{Distance, Pool};

/// Registers summed at a time.
const REGISTERS: usize = 4;

/// Replaces the frame distances of `patches` of a synthesis by patch distances to all patches of a
/// pool. No later patch reads the frame distances of an earlier patch's first frame.
pub(crate) struct Diagonals<'a> {
    pub(crate) pool: &'a Pool,
    pub(crate) distance: Distance,
    /// Frame distances, `[frames, frames of the pool]`.
    pub(crate) distances: &'a mut [f32],
    pub(crate) patches: Range<usize>,
    /// Added to all distances of a frame.
    pub(crate) still: &'a [f32],
}

impl WithSimd for Diagonals<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let (p, width) = (self.pool.patch_size, self.pool.frames.frames());
        let lanes = S::F32_LANES;
        for i in self.patches.clone() {
            let mut still = 0.0;
            for value in &self.still[i..i + p] {
                still += value;
            }
            let still = simd.splat_f32s(still);
            for (first, start, patches) in self.pool.runs() {
                // A patch's number is at most that of its first frame, so nothing unread is
                // overwritten.
                let mut done = 0;
                while done < patches {
                    let (from, to) = (i * width + start + done, i * width + first + done);
                    let left = patches - done;
                    done += if left >= REGISTERS * lanes {
                        self.sum::<S, REGISTERS>(simd, still, from, to, REGISTERS * lanes)
                    } else {
                        self.sum::<S, 1>(simd, still, from, to, left.min(lanes))
                    };
                }
            }
        }
    }
}

impl Diagonals<'_> {
    /// The distances of `count` patches, in R registers, whose frame distances begin at `from`.
    /// Returns `count`.
    #[inline(always)]
    fn sum<S: Simd, const R: usize>(
        &mut self,
        simd: S,
        still: S::f32s,
        from: usize,
        to: usize,
        count: usize,
    ) -> usize {
        let (p, width) = (self.pool.patch_size, self.pool.frames.frames());
        let lanes = S::F32_LANES;
        let mut sums = [still; R];
        for k in 0..p {
            let from = from + k * (width + 1);
            let frames = &self.distances[from..from + count];
            for (r, sum) in sums.iter_mut().enumerate() {
                let values = match count == R * lanes {
                    true => S::as_simd_f32s(&frames[r * lanes..(r + 1) * lanes]).0[0],
                    false => simd.partial_load_f32s(frames),
                };
                *sum = simd.add_f32s(*sum, values);
            }
        }
        let values = simd.splat_f32s((self.pool.frames.channels() * p) as f32);
        let out = &mut self.distances[to..to + count];
        for (sum, out) in sums.iter().zip(out.chunks_mut(lanes)) {
            let distance = match self.distance {
                Distance::MeanSquare => simd.div_f32s(*sum, values),
                Distance::L2 => simd.sqrt_f32s(*sum),
            };
            simd.partial_store_f32s(out, distance);
        }
        count
    }
}
