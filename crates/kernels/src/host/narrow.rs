//! Products of few windows with many weights.
//!
//! Packing the weights would cost as much as the product. This algorithm packs the windows instead
//! and reads the weights once, in place.

use pulp::{Arch, Simd, WithSimd};

use super::packing::turn_windows;
use super::product::{Addends, OutputRows, TILE_ROWS, WIDEST, Windows, panel_size, tile, vectors};
use super::team;

/// Maximum number of windows of several taps for which this algorithm can be faster.
const MOST_ROWS: usize = 32;

/// Maximum number of windows of one tap, for which weights are quick to pack.
const MOST_ROWS_OF_ONE_TAP: usize = 16;

/// Minimum number of output channels of a task.
const LEAST_CHANNELS: usize = 4 * TILE_ROWS;

/// True if a product has few windows of few taps relative to its output channels.
pub(crate) fn is_narrow(rows: usize, channels: usize, taps: usize) -> bool {
    let most = match taps {
        1 => MOST_ROWS_OF_ONE_TAP,
        _ => MOST_ROWS,
    };
    (1..=most).contains(&rows) && 2 * rows <= channels
}

/// `output = windows weight^T + addends` for a weight `[channels, inner, kernel]` and windows of
/// all taps in order.
///
/// The order of each sum does not depend on the number of threads.
pub(crate) fn multiply_narrow(
    windows: Windows<'_>,
    weight: &[f32],
    [channels, inner, kernel]: [usize; 3],
    addends: Addends<'_>,
    output: OutputRows<'_>,
) {
    let [most, lanes] = panel_size();
    let total = windows.len();
    let groups = total.div_ceil(lanes);
    let depth = inner * kernel;
    // Vector g of depth d contains element d of `lanes` windows, from window `g lanes` on.
    let mut panels = vec![0.0; groups * depth * lanes];
    let parts = panels
        .chunks_mut(most * depth * lanes)
        .enumerate()
        .collect();
    team::for_each_item(parts, |(part, panel): (usize, &mut [f32])| {
        let first = part * most * lanes;
        let width = panel.len() / depth;
        let rows: Vec<&[f32]> = (first..total.min(first + width))
            .map(|i| windows.at(i))
            .collect();
        turn_windows(&rows, [inner, kernel], width, panel);
    });

    let wanted = 4 * rayon::current_num_threads();
    let part = channels
        .div_ceil(wanted)
        .max(LEAST_CHANNELS)
        .next_multiple_of(TILE_ROWS);
    team::for_each(channels.div_ceil(part), |task| {
        let first = task * part;
        Arch::new().dispatch(RunTask {
            windows,
            weight,
            panels: &panels,
            depth,
            channels: first..(first + part).min(channels),
            addends,
            output,
        });
    });
}

/// Some output channels of all windows.
struct RunTask<'a> {
    windows: Windows<'a>,
    weight: &'a [f32],
    panels: &'a [f32],
    depth: usize,
    channels: std::ops::Range<usize>,
    addends: Addends<'a>,
    output: OutputRows<'a>,
}

impl WithSimd for RunTask<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let most = vectors::<S>() * S::F32_LANES;
        for (index, panel) in self.panels.chunks(most * self.depth).enumerate() {
            let first = index * most;
            match panel.len() / (self.depth * S::F32_LANES) {
                1 => self.run::<S, 1>(simd, panel, first),
                2 => self.run::<S, 2>(simd, panel, first),
                3 => self.run::<S, 3>(simd, panel, first),
                _ => self.run::<S, 4>(simd, panel, first),
            }
        }
    }
}

impl RunTask<'_> {
    #[inline(always)]
    fn run<S: Simd, const NR: usize>(&self, simd: S, panel: &[f32], first: usize) {
        let width = NR * S::F32_LANES;
        let panel = pulp::as_arrays::<NR, _>(S::as_simd_f32s(panel).0).0;
        let rows = first..self.windows.len().min(first + width);
        for channel in self.channels.clone().step_by(TILE_ROWS) {
            // Channels beyond the last repeat the last channel and are not written.
            let last = self.channels.end - 1;
            let weights: [&[f32]; TILE_ROWS] = std::array::from_fn(|i| {
                &self.weight[(channel + i).min(last) * self.depth..][..self.depth]
            });
            let sums = tile(simd, weights, panel);
            let mut turned = [[0.0_f32; TILE_ROWS]; WIDEST];
            for (i, sums) in sums.iter().enumerate() {
                for (n, sum) in sums.iter().enumerate() {
                    let mut lanes = [0.0_f32; LONGEST];
                    simd.partial_store_f32s(&mut lanes[..S::F32_LANES], *sum);
                    for (l, value) in lanes[..S::F32_LANES].iter().enumerate() {
                        turned[n * S::F32_LANES + l][i] = *value;
                    }
                }
            }
            let count = TILE_ROWS.min(self.channels.end - channel);
            for (index, values) in rows.clone().zip(&mut turned) {
                self.write(index, channel, &mut values[..count]);
            }
        }
    }

    /// Writes some channels of one output row plus the addends.
    #[inline(always)]
    fn write(&self, index: usize, channel: usize, values: &mut [f32]) {
        let (sample, row) = (index / self.windows.rows, index % self.windows.rows);
        let time = self.output.first + row * self.output.step;
        // SAFETY: a task owns its channels of all rows, and this is its only slice of them.
        #[allow(unsafe_code)]
        let out = unsafe {
            self.output
                .rows
                .segment(sample, time, channel, values.len())
        };
        if let Some(bias) = self.addends.bias {
            for (value, bias) in values.iter_mut().zip(&bias[channel..]) {
                *value += bias;
            }
        }
        if let Some(residual) = self.addends.residual {
            for (value, residual) in values
                .iter_mut()
                .zip(&residual.row(sample, time)[channel..])
            {
                *value += residual;
            }
        }
        out.write_copy_of_slice(values);
    }
}

/// Elements of the longest vector of any processor.
const LONGEST: usize = 16;
