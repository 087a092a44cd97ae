//! Scaled dot-product attention without a stored score matrix.
//!
//! A buffer contains the scores of one head; the backward pass recomputes scores from queries and
//! keys. The scores of some hundred frames fit in cache. Queries of longer sequences are processed
//! in parts, so that memory is linear in the length.

use std::cell::RefCell;
use std::ops::Range;

use gemm::{Parallelism, gemm};

use super::rows::{Rows, SharedRows};
use super::simd::{exp, vectorized};
use super::team;
use crate::lengths::KeyRanges;

/// Queries, keys and values, all heads side by side in the channels.
#[derive(Clone, Copy)]
pub struct Heads<'a> {
    /// `[batch, time, channels]`.
    pub queries: Rows<'a>,
    /// `[batch, keys, channels]`.
    pub keys: Rows<'a>,
    /// `[batch, keys, channels]`.
    pub values: Rows<'a>,
    /// Number of heads.
    pub num_heads: usize,
    /// Keys that each query attends to.
    pub attended: Attended<'a>,
}

/// Keys that each query attends to.
#[derive(Clone, Copy)]
pub enum Attended<'a> {
    /// All keys.
    All,
    /// The first keys of each sample, by their number.
    First(&'a [usize]),
    /// A range per query.
    Ranges(&'a KeyRanges),
}

impl Attended<'_> {
    /// Keys of a query, out of `keys`.
    fn of(self, sample: usize, query: usize, keys: usize) -> Range<usize> {
        match self {
            Self::All => 0..keys,
            Self::First(lengths) => 0..lengths[sample],
            Self::Ranges(ranges) => ranges.of(sample, query),
        }
    }

    /// The smallest range that contains the keys of `queries`.
    fn span(self, sample: usize, queries: Range<usize>, keys: usize) -> Range<usize> {
        match self {
            Self::Ranges(ranges) => ranges.span(sample, queries),
            _ => self.of(sample, queries.start, keys),
        }
    }
}

/// The channels of shared rows from `first` on.
#[derive(Clone, Copy)]
pub(crate) struct Columns<'a> {
    pub rows: SharedRows<'a>,
    pub first: usize,
}

/// Maximum number of scores in memory per thread: those of a thousand frames. The value is lower in
/// tests, so that tests use parts too.
const MOST_SCORES: usize = if cfg!(test) { 256 } else { 1 << 20 };

/// Minimum number of queries of a part with narrow ranges.
const SHORTEST_PART: usize = if cfg!(test) { 2 } else { 32 };

/// Buffers of a thread.
#[derive(Default)]
struct Buffers {
    /// Attention weights, `[part, keys]`.
    weights: Vec<f32>,
    /// Gradient of the scores, `[part, keys]`.
    scores: Vec<f32>,
    /// Results for a part of the queries.
    sums: Vec<f32>,
    /// Gradients, `[keys, head channels]`.
    of_keys: Vec<f32>,
    of_values: Vec<f32>,
}

thread_local! {
    static SCORES: RefCell<Buffers> = RefCell::default();
}

/// A matrix in memory: element `(i, j)` is `data[i row + j column]`.
#[derive(Clone, Copy)]
struct Matrix<'a> {
    data: &'a [f32],
    row: usize,
    column: usize,
}

impl Matrix<'_> {
    /// The rows from `row` on.
    fn from(self, row: usize) -> Self {
        Self {
            data: &self.data[row * self.row..],
            ..self
        }
    }

    fn transposed(self) -> Self {
        Self {
            row: self.column,
            column: self.row,
            ..self
        }
    }
}

/// `output = scale lhs rhs`, dense; with `add` the product is added to the output.
fn product(
    output: &mut [f32],
    add: bool,
    scale: f32,
    lhs: Matrix<'_>,
    rhs: Matrix<'_>,
    size: [usize; 3],
) {
    let [rows, depth, columns] = size;
    assert_eq!(output.len(), rows * columns, "product");
    let reach = |matrix: Matrix<'_>, [i, j]: [usize; 2]| {
        assert!(
            (i - 1) * matrix.row + (j - 1) * matrix.column < matrix.data.len(),
            "operand"
        );
    };
    reach(lhs, [rows, depth]);
    reach(rhs, [depth, columns]);
    // SAFETY: the last element of each operand was checked to lie inside it and the output to be
    // dense; `output` is borrowed mutably, so that it overlaps neither.
    #[allow(unsafe_code)]
    unsafe {
        gemm(
            rows,
            columns,
            depth,
            output.as_mut_ptr(),
            1,
            columns as isize,
            add,
            lhs.data.as_ptr(),
            lhs.column as isize,
            lhs.row as isize,
            rhs.data.as_ptr(),
            rhs.column as isize,
            rhs.row as isize,
            if add { 1.0 } else { 0.0 },
            scale,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

impl<'a> Heads<'a> {
    fn head_channels(&self) -> usize {
        self.queries.channels / self.num_heads
    }

    /// One head of one sample.
    fn matrix(&self, rows: Rows<'a>, sample: usize, head: usize) -> Matrix<'a> {
        Matrix {
            data: &rows.data[sample * rows.sample_stride + head * self.head_channels()..],
            row: rows.row_stride,
            column: 1,
        }
    }

    fn scale(&self) -> f32 {
        (self.head_channels() as f32).sqrt().recip()
    }

    /// Runs `work(sample, head)` for every head of every sample.
    fn for_each(&self, work: impl Fn(usize, usize) + Sync) {
        let heads = self.num_heads;
        team::for_each(self.queries.batch * heads, |index| {
            work(index / heads, index % heads)
        });
    }

    /// The queries in parts whose scores fit into a buffer. With narrow ranges the parts are short,
    /// so that each spans few keys.
    fn parts(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let (time, keys) = (self.queries.time, self.keys.time);
        let most = (MOST_SCORES / keys.max(1)).max(1);
        let length = match self.attended {
            Attended::Ranges(ranges) if 2 * ranges.widest() < keys => (ranges.widest() / 4)
                .clamp(SHORTEST_PART, time.max(SHORTEST_PART))
                .min(most),
            _ => most,
        };
        let starts = (0..time).step_by(length);
        starts.map(move |start| start..time.min(start + length))
    }

    /// Writes the attention `[part, span]` of one head to `weights` and returns the span of keys.
    fn weights(
        &self,
        sample: usize,
        head: usize,
        part: Range<usize>,
        weights: &mut Vec<f32>,
    ) -> Range<usize> {
        let span = self.attended.span(sample, part.clone(), self.keys.time);
        let keys = span.len();
        weights.resize(part.len() * keys, 0.0);
        if span.is_empty() {
            return span;
        }
        let queries = self.matrix(self.queries, sample, head).from(part.start);
        let keys_matrix = self.matrix(self.keys, sample, head).from(span.start);
        let size = [part.len(), self.head_channels(), keys];
        product(
            weights,
            false,
            self.scale(),
            queries,
            keys_matrix.transposed(),
            size,
        );
        let ranges = part.map(|query| {
            let Range { start, end } = self.attended.of(sample, query, self.keys.time);
            // An empty range may lie outside the span.
            let inside = |key: usize| key.clamp(span.start, span.end) - span.start;
            inside(start)..inside(end)
        });
        vectorized(
            #[inline(always)]
            || {
                for (row, range) in weights.chunks_exact_mut(keys).zip(ranges) {
                    if range.len() == keys {
                        softmax(row);
                        continue;
                    }
                    let (before, rest) = row.split_at_mut(range.start);
                    let (inside, behind) = rest.split_at_mut(range.len());
                    before.fill(0.0);
                    behind.fill(0.0);
                    if !inside.is_empty() {
                        softmax(inside);
                    }
                }
            },
        );
        span
    }

    /// `softmax(queries keys^T / sqrt(head channels)) values`: `[batch, time, channels]`.
    pub fn forward(&self) -> Vec<f32> {
        let (shape, head_channels) = (self.queries.shape(), self.head_channels());
        let mut output = vec![0.0; shape.iter().product()];
        let rows = SharedRows::dense(&mut output, shape);
        self.for_each(|sample, head| {
            SCORES.with_borrow_mut(|Buffers { weights, sums, .. }| {
                for part in self.parts() {
                    let span = self.weights(sample, head, part.clone(), weights);
                    if span.is_empty() {
                        continue;
                    }
                    sums.resize(part.len() * head_channels, 0.0);
                    let weights = dense(weights, span.len());
                    let values = self.matrix(self.values, sample, head).from(span.start);
                    let size = [part.len(), span.len(), head_channels];
                    product(sums, false, 1.0, weights, values, size);
                    let columns = Columns { rows, first: 0 };
                    let place = [sample, part.start, head * head_channels];
                    columns.write(place, sums, head_channels);
                }
            });
        });
        output
    }

    /// Writes the gradients of queries, keys and values, but not of unattended keys.
    pub(crate) fn backward(&self, gradient: Rows<'a>, into: [Columns<'_>; 3]) {
        let [queries_into, keys_into, values_into] = into;
        let channels = self.head_channels();
        let scale = self.scale();
        self.for_each(|sample, head| {
            let queries = self.queries.time;
            let all = self.attended.span(sample, 0..queries, self.keys.time);
            SCORES.with_borrow_mut(|buffers| {
                let Buffers {
                    weights,
                    scores,
                    sums,
                    of_keys,
                    of_values,
                } = buffers;
                let first = head * channels;
                for sums in [&mut *of_keys, &mut *of_values] {
                    sums.clear();
                    sums.resize(all.len() * channels, 0.0);
                }
                for part in self.parts() {
                    let length = part.len();
                    let span = self.weights(sample, head, part.clone(), weights);
                    if span.is_empty() {
                        continue;
                    }
                    let keys = span.len();
                    let place = span.start - all.start;
                    let place = place * channels..(place + keys) * channels;
                    let gradient = self.matrix(gradient, sample, head).from(part.start);

                    let transposed = dense(weights, keys).transposed();
                    let size = [keys, length, channels];
                    product(
                        &mut of_values[place.clone()],
                        true,
                        1.0,
                        transposed,
                        gradient,
                        size,
                    );

                    scores.resize(length * keys, 0.0);
                    let values = self.matrix(self.values, sample, head).from(span.start);
                    let size = [length, channels, keys];
                    product(scores, false, 1.0, gradient, values.transposed(), size);
                    vectorized(
                        #[inline(always)]
                        || {
                            let rows = scores
                                .chunks_exact_mut(keys)
                                .zip(weights.chunks_exact(keys));
                            rows.for_each(|(scores, weights)| softmax_backward(scores, weights));
                        },
                    );

                    let queries = self.matrix(self.queries, sample, head).from(part.start);
                    let transposed = dense(scores, keys).transposed();
                    let size = [keys, length, channels];
                    product(&mut of_keys[place], true, scale, transposed, queries, size);

                    sums.resize(length * channels, 0.0);
                    let keys_matrix = self.matrix(self.keys, sample, head).from(span.start);
                    let size = [length, keys, channels];
                    product(sums, false, scale, dense(scores, keys), keys_matrix, size);
                    let place = [sample, part.start, first];
                    queries_into.write(place, sums, channels);
                }
                let place = [sample, all.start, first];
                keys_into.write(place, of_keys, channels);
                values_into.write(place, of_values, channels);
            });
        });
    }
}

impl Columns<'_> {
    /// Writes rows of one head; the place is the sample, the first row and the first column.
    fn write(&self, place: [usize; 3], rows: &[f32], channels: usize) {
        let [sample, start, first] = place;
        for (time, row) in (start..).zip(rows.chunks_exact(channels)) {
            // SAFETY: a task owns its head's columns of its sample, and queries, keys and values
            // have separate columns or buffers; this is the only slice of them.
            #[allow(unsafe_code)]
            let out = unsafe {
                self.rows
                    .segment(sample, time, self.first + first, channels)
            };
            out.copy_from_slice(row);
        }
    }
}

fn dense(data: &[f32], columns: usize) -> Matrix<'_> {
    Matrix {
        data,
        row: columns,
        column: 1,
    }
}

/// Parallel partial results, for vectorization.
const LANES: usize = 16;

#[inline(always)]
fn softmax(row: &mut [f32]) {
    let mut largest = [f32::NEG_INFINITY; LANES];
    let (lines, rest) = row.as_chunks::<LANES>();
    for line in lines {
        for (largest, value) in largest.iter_mut().zip(line) {
            *largest = largest.max(*value);
        }
    }
    let largest = largest
        .iter()
        .chain(rest)
        .copied()
        .fold(f32::NEG_INFINITY, f32::max);
    let mut sums = [0.0_f32; LANES];
    let (lines, rest) = row.as_chunks_mut::<LANES>();
    for line in lines {
        for (sum, value) in sums.iter_mut().zip(line) {
            *value = exp(*value - largest);
            *sum += *value;
        }
    }
    let mut sum: f32 = sums.iter().sum();
    for value in rest {
        *value = exp(*value - largest);
        sum += *value;
    }
    let reciprocal = 1.0 / sum;
    for value in row.iter_mut() {
        *value *= reciprocal;
    }
}

/// `ds = p (dp - sum(dp p))`.
#[inline(always)]
fn softmax_backward(gradient: &mut [f32], weights: &[f32]) {
    let mut sums = [0.0_f32; LANES];
    let (gradients, rest) = gradient.as_chunks::<LANES>();
    let (lines, weights_rest) = weights.as_chunks::<LANES>();
    for (gradient, weights) in gradients.iter().zip(lines) {
        for ((sum, gradient), weight) in sums.iter_mut().zip(gradient).zip(weights) {
            *sum += gradient * weight;
        }
    }
    let rest = rest.iter().zip(weights_rest).map(|(g, w)| g * w);
    let sum = sums.into_iter().chain(rest).sum::<f32>();
    for (gradient, weight) in gradient.iter_mut().zip(weights) {
        *gradient = weight * (*gradient - sum);
    }
}
