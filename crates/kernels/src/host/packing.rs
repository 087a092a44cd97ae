//! Packing a convolution's weights into panels for products.

use super::columns::{LINES, write_columns};
use super::simd::vectorized;
use super::team;

/// Order in which a matrix product reads a weight `[outer, inner, kernel]`.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Direction<'a> {
    /// Columns are the outer channels; windows contain the inner channels of all taps, in order.
    Gather,
    /// Columns are the inner channels; windows contain the outer channels of these taps.
    Scatter(&'a [usize]),
}

/// A weight and its reading order.
#[derive(Clone, Copy)]
pub(crate) struct Weight<'a> {
    pub data: &'a [f32],
    /// `[outer, inner, kernel]`.
    pub shape: [usize; 3],
    pub direction: Direction<'a>,
}

impl Weight<'_> {
    /// Output channels.
    pub fn columns(&self) -> usize {
        match self.direction {
            Direction::Gather => self.shape[0],
            Direction::Scatter(_) => self.shape[1],
        }
    }

    /// True if windows contain all taps in order.
    pub fn gathers(&self) -> bool {
        matches!(self.direction, Direction::Gather)
    }

    /// Elements of a window.
    pub fn depth(&self) -> usize {
        match self.direction {
            Direction::Gather => self.shape[1] * self.shape[2],
            Direction::Scatter(taps) => self.shape[0] * taps.len(),
        }
    }

    /// All panels of `width` columns, in order.
    pub fn packed(&self, width: usize) -> Vec<f32> {
        let len = self.depth() * width;
        let mut panels = vec![0.0; self.columns().div_ceil(width) * len];
        let each = panels.chunks_mut(len).enumerate().collect();
        team::for_each_item(each, |(panel, packed): (usize, &mut [f32])| {
            self.pack(panel * width, width, packed);
        });
        panels
    }

    /// Writes columns `first..first + width` as one row of `width` per depth; missing columns are
    /// zeros.
    pub fn pack(&self, first: usize, width: usize, panel: &mut [f32]) {
        let columns = width.min(self.columns() - first);
        if columns < width {
            panel.fill(0.0);
        }
        vectorized(
            #[inline(always)]
            || match self.shape[2] {
                1 => self.pack_kernel::<1>(first, columns, width, panel),
                3 => self.pack_kernel::<3>(first, columns, width, panel),
                4 => self.pack_kernel::<4>(first, columns, width, panel),
                5 => self.pack_kernel::<5>(first, columns, width, panel),
                _ => self.pack_any(first, columns, width, panel),
            },
        );
    }

    #[inline(always)]
    fn pack_kernel<const K: usize>(
        &self,
        first: usize,
        columns: usize,
        width: usize,
        panel: &mut [f32],
    ) {
        let line = self.shape[1] * K;
        match self.direction {
            Direction::Gather => {
                let inner = self.shape[1];
                let weights = &self.data[first * line..(first + columns) * line];
                let mut blocks = weights.chunks_exact(LINES * line);
                for (block, lines) in (&mut blocks).enumerate() {
                    let lines: [&[f32]; LINES] =
                        std::array::from_fn(|i| &lines[i * line..(i + 1) * line]);
                    let panel = &mut panel[block * LINES..];
                    match K {
                        1 => {
                            let next = first + (block + 1) * LINES;
                            let next = self.data.get(next * line..).unwrap_or_default();
                            write_columns(lines, width, panel, next);
                        }
                        _ => turn::<K, LINES>(lines, inner, width, panel),
                    }
                }
                let done = columns - columns % LINES;
                for (i, line) in blocks.remainder().chunks_exact(line).enumerate() {
                    turn::<K, 1>([line], inner, width, &mut panel[done + i..]);
                }
            }
            Direction::Scatter(taps) => {
                let outer = self.shape[0];
                for (source, line) in self.data.chunks_exact(line).enumerate() {
                    let line = &line[first * K..(first + columns) * K];
                    for (j, &tap) in taps.iter().enumerate() {
                        let out = &mut panel[(j * outer + source) * width..][..columns];
                        for (out, taps) in out.iter_mut().zip(line.chunks_exact(K)) {
                            *out = taps[tap];
                        }
                    }
                }
            }
        }
    }

    fn pack_any(&self, first: usize, columns: usize, width: usize, panel: &mut [f32]) {
        let [outer, inner, kernel] = self.shape;
        let at = |a: usize, c: usize, k: usize| self.data[(a * inner + c) * kernel + k];
        for column in 0..columns {
            match self.direction {
                Direction::Gather => {
                    for (depth, row) in panel.chunks_exact_mut(width).enumerate() {
                        row[column] = at(first + column, depth % inner, depth / inner);
                    }
                }
                Direction::Scatter(taps) => {
                    for (depth, row) in panel.chunks_exact_mut(width).enumerate() {
                        row[column] = at(depth % outer, first + column, taps[depth / outer]);
                    }
                }
            }
        }
    }
}

/// Writes lines `[inner, K]` as columns: `panel[(k inner + c) width + i] = lines[i][c K + k]`.
#[inline(always)]
fn turn<const K: usize, const N: usize>(
    lines: [&[f32]; N],
    inner: usize,
    width: usize,
    panel: &mut [f32],
) {
    let lines = lines.map(|line| &line.as_chunks::<K>().0[..inner]);
    for c in 0..inner {
        for k in 0..K {
            let out = &mut panel[(k * inner + c) * width..][..N];
            for (out, line) in out.iter_mut().zip(&lines) {
                *out = line[c][k];
            }
        }
    }
}

/// Writes windows `[kernel, inner]` as columns in the order of a weight:
/// `panel[(c kernel + k) width + i] = windows[i][k inner + c]`. Other columns do not change.
pub(crate) fn turn_windows(
    windows: &[&[f32]],
    [inner, kernel]: [usize; 2],
    width: usize,
    panel: &mut [f32],
) {
    vectorized(
        #[inline(always)]
        || {
            for (block, windows) in windows.chunks(LINES).enumerate() {
                for k in 0..kernel {
                    let lines: [&[f32]; LINES] = std::array::from_fn(|i| match windows.get(i) {
                        Some(window) => &window[k * inner..(k + 1) * inner],
                        None => &[],
                    });
                    if windows.len() == LINES {
                        let panel = &mut panel[k * width + block * LINES..];
                        write_columns(lines, kernel * width, panel, &[]);
                    } else {
                        for (i, line) in lines.iter().enumerate() {
                            for (c, value) in line.iter().enumerate() {
                                panel[(c * kernel + k) * width + block * LINES + i] = *value;
                            }
                        }
                    }
                }
            }
        },
    );
}
