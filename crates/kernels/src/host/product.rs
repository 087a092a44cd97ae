//! Matrix products of windows of rows with a convolution's weights.
//!
//! A window is `taps` consecutive rows in memory: one row of the im2col matrix, read in place.

use std::cell::RefCell;
use std::mem::MaybeUninit;

use pulp::{Arch, Simd, WithSimd};

use super::packed_cache;
use super::packing::Weight;
use super::rows::{Rows, SharedRows};
use super::team;

/// Rows of a tile: six rows of four vectors are 24 sums in registers.
pub(crate) const TILE_ROWS: usize = 6;

/// Minimum number of rows of a task.
const LEAST_ROWS: usize = 24;

/// Windows of equal depth at equal distances in each sample.
#[derive(Clone, Copy)]
pub(crate) struct Windows<'a> {
    /// From the first window on.
    pub data: &'a [f32],
    pub batch: usize,
    /// Windows of a sample.
    pub rows: usize,
    pub sample_stride: usize,
    pub row_stride: usize,
    /// Elements of a window.
    pub depth: usize,
}

impl<'a> Windows<'a> {
    #[inline(always)]
    pub fn at(&self, index: usize) -> &'a [f32] {
        let (sample, row) = (index / self.rows, index % self.rows);
        &self.data[sample * self.sample_stride + row * self.row_stride..][..self.depth]
    }

    pub fn len(&self) -> usize {
        self.batch * self.rows
    }
}

/// Addends of a product.
#[derive(Clone, Copy, Default)]
pub(crate) struct Addends<'a> {
    /// One value per column.
    pub bias: Option<&'a [f32]>,
    /// One value per element of the output.
    pub residual: Option<Rows<'a>>,
}

/// Output rows of the windows: `first + row step`.
#[derive(Clone, Copy)]
pub(crate) struct OutputRows<'a> {
    pub rows: SharedRows<'a, MaybeUninit<f32>>,
    pub first: usize,
    pub step: usize,
}

thread_local! {
    /// Panel of the current products of this thread.
    pub(crate) static PANEL: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// `output = windows weight^T + addends`, written to every column of the windows' rows.
///
/// The order of each sum does not depend on the number of threads.
pub(crate) fn multiply(
    windows: Windows<'_>,
    weight: Weight<'_>,
    addends: Addends<'_>,
    output: OutputRows<'_>,
) {
    assert_eq!(windows.depth, weight.depth(), "depth");
    if windows.len() == 0 {
        return;
    }
    let width = panel_width();
    let packed = packed_cache::panels(&weight, windows.len());
    let panels = weight.columns().div_ceil(width);
    let wanted = (2 * rayon::current_num_threads()).div_ceil(panels);
    let parts = wanted.min(windows.len() / LEAST_ROWS).max(1);
    let part = windows.len().div_ceil(parts).next_multiple_of(TILE_ROWS);
    let tasks: Vec<(usize, usize)> = (0..panels)
        .flat_map(|panel| {
            (0..windows.len())
                .step_by(part)
                .map(move |row| (panel, row))
        })
        .collect();
    team::for_each(tasks.len(), |task| {
        let (panel, row) = tasks[task];
        let task = PanelTask {
            windows,
            weight,
            packed: packed.as_deref().map(Vec::as_slice),
            addends,
            output,
            first_column: panel * width,
            rows: row..(row + part).min(windows.len()),
        };
        PANEL.with_borrow_mut(|scratch| RunPanel { task, scratch }.dispatch());
    });
}

/// Columns of a panel on this processor.
pub(crate) fn panel_width() -> usize {
    panel_size().into_iter().product()
}

/// Number of vectors of a panel on this processor, and number of elements of a vector.
pub(crate) fn panel_size() -> [usize; 2] {
    struct PanelSize;
    impl WithSimd for PanelSize {
        type Output = [usize; 2];

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> [usize; 2] {
            [vectors::<S>(), S::F32_LANES]
        }
    }
    Arch::new().dispatch(PanelSize)
}

/// Work on tiles of `NR` vectors a row.
pub(crate) trait TileWork: Sized {
    /// Does the work.
    fn run<S: Simd, const NR: usize>(self, simd: S);

    /// Does the work with the best instruction set of this processor.
    fn dispatch(self) {
        Arch::new().dispatch(Dispatched(self));
    }
}

struct Dispatched<W>(W);

impl<W: TileWork> WithSimd for Dispatched<W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if vectors::<S>() == 4 {
            self.0.run::<S, 4>(simd);
        } else {
            self.0.run::<S, 2>(simd);
        }
    }
}

/// Number of vectors of a tile's row, which leaves registers for the operands.
#[inline(always)]
pub(crate) const fn vectors<S: Simd>() -> usize {
    if S::REGISTER_COUNT >= 32 { 4 } else { 2 }
}

struct PanelTask<'a> {
    windows: Windows<'a>,
    weight: Weight<'a>,
    /// All panels, if they are cached.
    packed: Option<&'a [f32]>,
    addends: Addends<'a>,
    output: OutputRows<'a>,
    first_column: usize,
    rows: std::ops::Range<usize>,
}

struct RunPanel<'a, 'b> {
    task: PanelTask<'a>,
    scratch: &'b mut Vec<f32>,
}

impl TileWork for RunPanel<'_, '_> {
    #[inline(always)]
    fn run<S: Simd, const NR: usize>(self, simd: S) {
        let Self { task, scratch } = self;
        let width = NR * S::F32_LANES;
        let depth = task.windows.depth;
        let columns = width.min(task.weight.columns() - task.first_column);
        let panel = match task.packed {
            Some(packed) => &packed[task.first_column * depth..][..width * depth],
            None => {
                scratch.resize(depth * width, 0.0);
                task.weight.pack(task.first_column, width, scratch);
                scratch
            }
        };
        let panel = pulp::as_arrays::<NR, _>(S::as_simd_f32s(panel).0).0;
        for first in task.rows.clone().step_by(TILE_ROWS) {
            // Rows beyond the last repeat the last row and are not written.
            let last = task.rows.end - 1;
            let rows: [&[f32]; TILE_ROWS] =
                std::array::from_fn(|i| task.windows.at((first + i).min(last)));
            let sums = tile(simd, rows, panel);
            for (i, sums) in sums.iter().enumerate().take(task.rows.end - first) {
                task.write(simd, first + i, columns, sums);
            }
        }
    }
}

impl PanelTask<'_> {
    /// Writes one row of a tile plus the addends.
    #[inline(always)]
    fn write<S: Simd, const NR: usize>(
        &self,
        simd: S,
        index: usize,
        columns: usize,
        sums: &[S::f32s; NR],
    ) {
        let (sample, row) = (index / self.windows.rows, index % self.windows.rows);
        let time = self.output.first + row * self.output.step;
        let column = self.first_column;
        // SAFETY: a task owns its columns of its rows, and this is its only slice of them.
        #[allow(unsafe_code)]
        let out = unsafe { self.output.rows.segment(sample, time, column, columns) };
        let bias = self
            .addends
            .bias
            .map(|bias| &bias[column..column + columns]);
        let residual = self
            .addends
            .residual
            .map(|rows| &rows.row(sample, time)[column..column + columns]);
        let (whole, rest) = S::as_uninit_mut_simd_f32s(out);
        for (n, sum) in sums.iter().enumerate() {
            let lanes = n * S::F32_LANES..((n + 1) * S::F32_LANES).min(columns);
            if lanes.is_empty() {
                break;
            }
            let mut sum = *sum;
            if let Some(bias) = bias {
                sum = simd.add_f32s(sum, load(simd, &bias[lanes.clone()]));
            }
            if let Some(residual) = residual {
                sum = simd.add_f32s(sum, load(simd, &residual[lanes]));
            }
            match whole.get_mut(n) {
                Some(out) => {
                    out.write(sum);
                }
                None => {
                    let mut line = [0.0_f32; WIDEST];
                    let line = &mut line[..rest.len()];
                    simd.partial_store_f32s(line, sum);
                    rest.write_copy_of_slice(line);
                }
            }
        }
    }
}

/// A vector of `values`, filled up with zeros.
#[inline(always)]
fn load<S: Simd>(simd: S, values: &[f32]) -> S::f32s {
    match S::as_simd_f32s(values) {
        ([whole], []) => *whole,
        _ => simd.partial_load_f32s(values),
    }
}

/// Columns of the widest panel of any processor.
pub(crate) const WIDEST: usize = 64;

/// The sums of one tile: rows times a packed panel.
#[inline(always)]
pub(crate) fn tile<S: Simd, const NR: usize>(
    simd: S,
    rows: [&[f32]; TILE_ROWS],
    panel: &[[S::f32s; NR]],
) -> [[S::f32s; NR]; TILE_ROWS] {
    // The slices have equal lengths, so that no access below is checked.
    let rows = rows.map(|row| &row[..panel.len()]);
    let mut sums = [[simd.splat_f32s(0.0); NR]; TILE_ROWS];
    for (depth, vectors) in panel.iter().enumerate() {
        for (sums, row) in sums.iter_mut().zip(&rows) {
            let value = simd.splat_f32s(row[depth]);
            for (sum, vector) in sums.iter_mut().zip(vectors) {
                *sum = simd.mul_add_f32s(value, *vector, *sum);
            }
        }
    }
    sums
}
