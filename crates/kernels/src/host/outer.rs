//! Weight gradients: products summed over rows.

use std::mem::MaybeUninit;

use pulp::Simd;

use super::product::{PANEL, TILE_ROWS, TileWork, Windows};
use super::rows::Rows;
use super::simd::vectorized;
use super::team;

/// Rows of a pass, so that both sides stay in first-level cache.
const PASS: usize = 128;

/// Maximum number of sums of a task, which then fit a second-level cache.
const LARGEST_PART: usize = 1 << 19;

/// `[a, c, k] = sum over rows of lhs[a] window[k, c]`, for one row of `lhs` per window, and windows
/// of `taps` rows.
///
/// Sums are in row order and do not depend on the number of threads.
pub(crate) fn outer(lhs: Rows<'_>, windows: Windows<'_>, taps: usize) -> Vec<f32> {
    let depth = windows.depth;
    let len = lhs.channels * depth;
    // The buffer is not zeroed, because weight gradients are most of the memory that a step writes.
    let mut gradient = Vec::with_capacity(len);
    assert_eq!((lhs.batch, lhs.time), (windows.batch, windows.rows), "rows");
    assert!(
        depth.is_multiple_of(taps),
        "a window of {depth} elements and {taps} taps"
    );
    if windows.len() == 0 || len == 0 {
        return vec![0.0; len];
    }
    // The parts are the fewest that occupy all threads, because each part packs the windows.
    let most = (LARGEST_PART / depth.max(1)).max(TILE_ROWS) / TILE_ROWS * TILE_ROWS;
    let part = lhs
        .channels
        .div_ceil(rayon::current_num_threads())
        .next_multiple_of(TILE_ROWS)
        .min(most);
    let unwritten = &mut gradient.spare_capacity_mut()[..len];
    let parts = unwritten.chunks_mut(part * depth).enumerate().collect();
    team::for_each_item(
        parts,
        |(index, gradient): (usize, &mut [MaybeUninit<f32>])| {
            let lhs = lhs.narrow(index * part, gradient.len() / depth);
            PANEL.with_borrow_mut(|scratch| {
                let part = RunPart {
                    lhs,
                    windows,
                    taps,
                    gradient,
                    scratch,
                };
                part.dispatch();
            });
        },
    );
    // SAFETY: the parts cover the first `len` elements, and `RunPart` writes every element of its
    // part; a panic in a part would not reach this line.
    #[allow(unsafe_code)]
    unsafe {
        gradient.set_len(len);
    }
    gradient
}

/// One task: all columns of some left channels.
struct RunPart<'a, 'b> {
    lhs: Rows<'a>,
    windows: Windows<'a>,
    taps: usize,
    gradient: &'b mut [MaybeUninit<f32>],
    scratch: &'b mut Vec<f32>,
}

impl TileWork for RunPart<'_, '_> {
    #[inline(always)]
    fn run<S: Simd, const NR: usize>(self, simd: S) {
        let width = NR * S::F32_LANES;
        let depth = self.windows.depth;
        let channels = self.lhs.channels;
        let total = self.lhs.batch * self.lhs.time;
        // Sums are stored by tap in full tiles; those beyond the last channel or column are unused.
        let panels = depth.div_ceil(width);
        let tiles = channels.div_ceil(TILE_ROWS);
        let tile_len = TILE_ROWS * width;
        let sizes = [
            panels * tiles * tile_len,
            tiles * TILE_ROWS * PASS,
            width * PASS,
        ];
        let needed = sizes.iter().sum();
        if self.scratch.len() < needed {
            self.scratch.resize(needed, 0.0);
        }
        let (sums, packed) = self.scratch[..needed].split_at_mut(sizes[0]);
        let (packed_lhs, packed_windows) = packed.split_at_mut(sizes[1]);
        for first in (0..total).step_by(PASS) {
            let rows = PASS.min(total - first);
            for i in 0..rows {
                let index = first + i;
                let row = self.lhs.row(index / self.lhs.time, index % self.lhs.time);
                let (full, rest) = row.as_chunks::<TILE_ROWS>();
                let mut tiles = packed_lhs.chunks_exact_mut(TILE_ROWS * PASS);
                for (values, tile) in full.iter().zip(&mut tiles) {
                    tile.as_chunks_mut::<TILE_ROWS>().0[i] = *values;
                }
                if let Some(tile) = tiles.next() {
                    tile[i * TILE_ROWS..][..rest.len()].copy_from_slice(rest);
                }
            }
            for (panel, sums) in sums.chunks_exact_mut(tiles * tile_len).enumerate() {
                let columns = panel * width..((panel + 1) * width).min(depth);
                let lines = packed_windows.chunks_exact_mut(width).enumerate();
                for (i, packed) in lines.take(rows) {
                    let window = &self.windows.at(first + i)[columns.clone()];
                    if columns.len() == width {
                        let window = pulp::as_arrays::<NR, _>(S::as_simd_f32s(window).0).0[0];
                        pulp::as_arrays_mut::<NR, _>(S::as_mut_simd_f32s(packed).0).0[0] = window;
                    } else {
                        packed[..columns.len()].copy_from_slice(window);
                        packed[columns.len()..].fill(0.0);
                    }
                }
                let vectors = pulp::as_arrays::<NR, _>(S::as_simd_f32s(packed_windows).0).0;
                for (tile, sums) in sums.chunks_exact_mut(tile_len).enumerate() {
                    let values = &packed_lhs[tile * TILE_ROWS * PASS..][..TILE_ROWS * rows];
                    let sums = pulp::as_arrays_mut::<NR, _>(S::as_mut_simd_f32s(sums).0).0;
                    add_products(simd, values, &vectors[..rows], sums, first == 0);
                }
            }
        }
        for channel in 0..channels {
            let (tile, row) = (channel / TILE_ROWS, channel % TILE_ROWS);
            let out = &mut self.gradient[channel * depth..][..depth];
            let piece =
                |panel: usize| &sums[(panel * tiles + tile) * tile_len + row * width..][..width];
            vectorized(
                #[inline(always)]
                || match self.taps {
                    1 => interleave::<1>(piece, width, out),
                    3 => interleave::<3>(piece, width, out),
                    4 => interleave::<4>(piece, width, out),
                    5 => interleave::<5>(piece, width, out),
                    taps => interleave_any(piece, width, taps, out),
                },
            );
        }
    }
}

/// Adds the products of a tile's values, `TILE_ROWS` per row, and the rows' vectors to `sums`,
/// which start at zero if `fresh`.
#[inline(always)]
fn add_products<S: Simd, const NR: usize>(
    simd: S,
    values: &[f32],
    vectors: &[[S::f32s; NR]],
    sums: &mut [[S::f32s; NR]],
    fresh: bool,
) {
    let mut tile = [[simd.splat_f32s(0.0); NR]; TILE_ROWS];
    if !fresh {
        tile.copy_from_slice(sums);
    }
    for (values, vectors) in values.as_chunks::<TILE_ROWS>().0.iter().zip(vectors) {
        for (sums, value) in tile.iter_mut().zip(values) {
            let value = simd.splat_f32s(*value);
            for (sum, vector) in sums.iter_mut().zip(vectors) {
                *sum = simd.mul_add_f32s(value, *vector, *sum);
            }
        }
    }
    sums.copy_from_slice(&tile);
}

/// Reorders `[tap, channel]`, in pieces of `width`, to `[channel, tap]`.
#[inline(always)]
fn interleave<'a, const K: usize>(
    piece: impl Fn(usize) -> &'a [f32],
    width: usize,
    out: &mut [MaybeUninit<f32>],
) {
    let inner = out.len() / K;
    if !inner.is_multiple_of(width) {
        return interleave_any(piece, width, K, out);
    }
    let pieces = inner / width;
    for (index, out) in out
        .as_chunks_mut::<K>()
        .0
        .chunks_exact_mut(width)
        .enumerate()
    {
        let taps: [&[f32]; K] = std::array::from_fn(|k| &piece(k * pieces + index)[..width]);
        for (i, out) in out.iter_mut().enumerate() {
            *out = std::array::from_fn(|k| MaybeUninit::new(taps[k][i]));
        }
    }
}

#[inline(always)]
fn interleave_any<'a>(
    piece: impl Fn(usize) -> &'a [f32],
    width: usize,
    taps: usize,
    out: &mut [MaybeUninit<f32>],
) {
    let inner = out.len() / taps;
    for (i, out) in out.iter_mut().enumerate() {
        let from = (i % taps) * inner + i / taps;
        out.write(piece(from / width)[from % width]);
    }
}
