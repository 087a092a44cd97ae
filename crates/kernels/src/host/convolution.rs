//! Convolution over time: output, input gradient and weight gradient.
//!
//! Inputs are first written into zero-padded rows: copied, repeated (nearest upsampling) or
//! normalized. The backward pass recomputes these rows, which is cheaper than storing them.

use std::borrow::Cow;
use std::mem::MaybeUninit;

use super::geometry::{Geometry, Phase, margins};
use super::narrow::{is_narrow, multiply_narrow};
use super::norm::{self, GroupNormPlan, Norm, NormGradients};
use super::outer::outer;
use super::packing::{Direction, Weight};
use super::product::{Addends, OutputRows, Windows, multiply};
use super::rows::{Rows, SharedRows, padded_rows_written_by, rows_written_by};
use super::simd::vectorized;
use super::team;
use crate::invariance::samples;
use crate::lengths::frames_of;

/// A convolution without its tensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConvolutionPlan {
    /// Kernel, stride and padding.
    pub geometry: Geometry,
    /// True for a transposed convolution, with the weight `[in, out, kernel]`.
    pub transposed: bool,
    /// Repeats every input frame twice, then keeps this many frames.
    pub upsample: Option<usize>,
    /// Normalizes the input. Excludes `upsample`.
    pub norm: Option<GroupNormPlan>,
}

/// A convolution's input and the tensors of its normalization.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// Input frames.
    pub x: Rows<'a>,
    /// The normalization, if the plan has one.
    pub norm: Option<Norm<'a>>,
    /// Valid frames of each sample, also of the normalization; other frames are zeros.
    pub lengths: Option<&'a [usize]>,
}

/// The gradients to compute.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Gradients of input and normalization parameters.
    pub input: bool,
    /// Of the weight.
    pub weight: bool,
    /// Of the bias.
    pub bias: bool,
}

/// Gradients of a convolution; `None` where not wanted.
pub struct ConvolutionGradients {
    /// `[batch, time, in]`.
    pub input: Option<Vec<f32>>,
    /// In the weight's shape.
    pub weight: Option<Vec<f32>>,
    /// `[out]`.
    pub bias: Option<Vec<f32>>,
    /// Of the normalization's parameters.
    pub norm: Option<NormGradients>,
}

/// The source rows of the windows.
struct Source<'a> {
    data: Cow<'a, [f32]>,
    /// Zero rows before each sample.
    before: usize,
    shape: [usize; 3],
    sample_stride: usize,
    row_stride: usize,
}

impl ConvolutionPlan {
    /// Number of frames after upsampling `time` input frames.
    fn source_frames(&self, time: usize) -> usize {
        self.upsample.unwrap_or(time)
    }

    /// Output frames of `time` input frames.
    pub fn frames(&self, time: usize) -> usize {
        let source = self.source_frames(time);
        if self.transposed {
            self.geometry.long(source)
        } else {
            self.geometry.short(source)
        }
    }

    /// Output channels of a weight `[out, in, kernel]`, or `[in, out, kernel]` if transposed.
    pub fn out_channels(&self, weight: [usize; 3]) -> usize {
        weight[usize::from(self.transposed)]
    }

    /// The prepared input, with zero rows where `phases` reach beyond the input's ends.
    fn prepare<'a>(&self, input: Input<'a>, phases: &[Phase]) -> Source<'a> {
        let x = input.x;
        let frames = self.source_frames(x.time);
        assert!(
            self.norm.is_none() || self.upsample.is_none(),
            "normalised and repeated at once"
        );
        assert_eq!(
            self.norm.is_some(),
            input.norm.is_some(),
            "a normalisation's tensors"
        );
        if (self.upsample, self.norm, input.lengths) == (None, None, None) {
            return Source::pad(x, phases);
        }
        // SAFETY: a normalization and a copy write every element of every row.
        #[allow(unsafe_code)]
        unsafe {
            Source::written_by(
                [x.batch, frames, x.channels],
                margins(phases, frames),
                |rows| match &input.norm {
                    Some(norm) => norm::forward(x, norm, rows),
                    None => {
                        let repeats = if self.upsample.is_some() { 2 } else { 1 };
                        copy(x, frames, input.lengths, rows, |time| time / repeats);
                    }
                },
            )
        }
    }

    /// The convolution of the input plus `addends`, `[batch, frames, out]`.
    pub(crate) fn forward(
        &self,
        input: Input<'_>,
        weight: &[f32],
        weight_shape: [usize; 3],
        addends: Addends<'_>,
    ) -> Vec<f32> {
        let (batch, frames) = (input.x.batch, self.frames(input.x.time));
        let phases = self.geometry.phases(!self.transposed, frames);
        let source = self.prepare(input, &phases);
        let shape = [batch, frames, self.out_channels(weight_shape)];
        let weight = WeightView {
            data: weight,
            shape: weight_shape,
            gathers: !self.transposed,
        };
        multiply_phases(&source, &phases, weight, addends, shape)
    }

    /// The `wanted` gradients from the output's `gradient`.
    pub fn backward(
        &self,
        input: Input<'_>,
        weight: &[f32],
        weight_shape: [usize; 3],
        gradient: Rows<'_>,
        wanted: Wanted,
    ) -> ConvolutionGradients {
        let x = input.x;
        assert_eq!(gradient.batch, x.batch, "samples of input and gradient");
        assert_eq!(gradient.time, self.frames(x.time), "frames of the gradient");
        let frames = self.source_frames(x.time);
        let mut gradients = ConvolutionGradients {
            input: None,
            weight: None,
            bias: wanted.bias.then(|| column_sums(gradient)),
            norm: None,
        };
        // The side with fewer frames provides single rows, the other side provides windows.
        let phases = self.geometry.phases(self.transposed, frames);
        let padded_gradient = Source::pad(gradient, &phases);
        if wanted.weight {
            let kernel = self.geometry.kernel;
            gradients.weight = Some(if self.transposed {
                let source = self.prepare(input, &[]);
                outer(source.rows(), padded_gradient.windows(&phases[0]), kernel)
            } else {
                let forward = self.geometry.gather(gradient.time);
                let source = self.prepare(input, &forward);
                outer(gradient, source.windows(&forward[0]), kernel)
            });
        }
        if wanted.input {
            let shape = [x.batch, frames, x.channels];
            let weight = WeightView {
                data: weight,
                shape: weight_shape,
                gathers: self.transposed,
            };
            let addends = Addends::default();
            let mut output = multiply_phases(&padded_gradient, &phases, weight, addends, shape);
            if let (Some(lengths), None) = (input.lengths, self.norm) {
                clear_padding(&mut output, shape, lengths);
            }
            if self.upsample.is_some() {
                output = fold_pairs(Rows::dense(&output, shape), x.time);
            }
            gradients.norm = input.norm.map(|norm| norm::backward(x, &norm, &mut output));
            gradients.input = Some(output);
        }
        gradients
    }
}

impl<'a> Source<'a> {
    /// Rows written by `write`, with `before` and `after` zero rows around each sample's rows.
    ///
    /// # Safety
    /// `write` must write every element of the rows.
    #[allow(unsafe_code)]
    unsafe fn written_by(
        shape: [usize; 3],
        (before, after): (usize, usize),
        write: impl FnOnce(SharedRows<'_, MaybeUninit<f32>>),
    ) -> Self {
        let [_, time, channels] = shape;
        Self {
            // SAFETY: the caller's promise.
            data: Cow::Owned(unsafe { padded_rows_written_by(shape, before, after, write) }),
            before,
            shape,
            sample_stride: (before + time + after) * channels,
            row_stride: channels,
        }
    }

    /// `rows` with zeros where `phases` reach beyond the rows' ends, and without gaps if windows
    /// span several rows.
    fn pad(rows: Rows<'a>, phases: &[Phase]) -> Self {
        let margins = margins(phases, rows.time);
        let single = phases.iter().all(|phase| phase.taps.len() <= 1);
        if margins == (0, 0) && (single || rows.row_stride == rows.channels) {
            return Self {
                data: Cow::Borrowed(rows.data),
                before: 0,
                shape: rows.shape(),
                sample_stride: rows.sample_stride,
                row_stride: rows.row_stride,
            };
        }
        // SAFETY: a copy writes every element of every row.
        #[allow(unsafe_code)]
        unsafe {
            Self::written_by(rows.shape(), margins, |padded| {
                copy(rows, rows.time, None, padded, |time| time);
            })
        }
    }

    /// The windows of a phase.
    fn windows(&self, phase: &Phase) -> Windows<'_> {
        let [batch, _, channels] = self.shape;
        let (first, step) = match phase.taps.is_empty() {
            true => (0, 0),
            false => {
                let first = self.before as isize + phase.source_first;
                let first = usize::try_from(first).expect("padded enough");
                (first, phase.source_step)
            }
        };
        Windows {
            data: &self.data[first * self.row_stride..],
            batch,
            rows: phase.rows,
            sample_stride: self.sample_stride,
            row_stride: step * self.row_stride,
            depth: phase.taps.len() * channels,
        }
    }

    /// The rows without padding.
    fn rows(&self) -> Rows<'_> {
        let [batch, time, channels] = self.shape;
        Rows {
            data: &self.data[self.before * self.row_stride..],
            batch,
            time,
            channels,
            sample_stride: self.sample_stride,
            row_stride: self.row_stride,
        }
    }
}

/// A weight and the direction that reads it.
#[derive(Clone, Copy)]
struct WeightView<'a> {
    data: &'a [f32],
    shape: [usize; 3],
    gathers: bool,
}

/// `[batch, frames, channels]`: the products of every phase's windows.
fn multiply_phases(
    source: &Source<'_>,
    phases: &[Phase],
    weight: WeightView<'_>,
    addends: Addends<'_>,
    shape: [usize; 3],
) -> Vec<f32> {
    let columns = weight.shape[usize::from(!weight.gathers)];
    assert_eq!(
        (source.shape[0], columns),
        (shape[0], shape[2]),
        "samples and columns"
    );
    let rows: usize = phases.iter().map(|phase| phase.rows).sum();
    assert_eq!(rows, shape[1], "rows of the phases");
    // SAFETY: the phases' rows are all rows of all samples, and a product writes all columns.
    #[allow(unsafe_code)]
    unsafe {
        rows_written_by(shape, |rows| {
            for phase in phases {
                let weight = Weight {
                    data: weight.data,
                    shape: weight.shape,
                    direction: if weight.gathers {
                        Direction::Gather
                    } else {
                        Direction::Scatter(&phase.taps)
                    },
                };
                let output = OutputRows {
                    rows,
                    first: phase.first,
                    step: phase.step,
                };
                let windows = source.windows(phase);
                let taps = weight.shape[2];
                if weight.gathers() && is_narrow(windows.len() / samples(), columns, taps) {
                    multiply_narrow(windows, weight.data, weight.shape, addends, output);
                } else {
                    multiply(windows, weight, addends, output);
                }
            }
        })
    }
}

/// Copies row `from(t)` to each row t below the sample's length and writes zeros to other rows.
fn copy(
    x: Rows<'_>,
    frames: usize,
    lengths: Option<&[usize]>,
    output: SharedRows<'_, MaybeUninit<f32>>,
    from: impl Fn(usize) -> usize + Sync,
) {
    team::for_each(x.batch, |sample| {
        let length = frames_of(lengths, sample, frames);
        for time in 0..frames {
            // SAFETY: a task owns its sample, and this is its only slice of the row.
            #[allow(unsafe_code)]
            let out = unsafe { output.segment(sample, time, 0, x.channels) };
            if time < length {
                out.write_copy_of_slice(x.row(sample, from(time)));
            } else {
                out.fill(MaybeUninit::new(0.0));
            }
        }
    });
}

/// Sets the rows from each sample's length on to zero.
fn clear_padding(rows: &mut [f32], [_, time, channels]: [usize; 3], lengths: &[usize]) {
    if time * channels > 0 {
        let samples = rows.chunks_exact_mut(time * channels);
        for (sample, &length) in samples.zip(lengths) {
            sample[length * channels..].fill(0.0);
        }
    }
}

/// Sums rows `2 t` and `2 t + 1`, where the second exists.
fn fold_pairs(rows: Rows<'_>, time: usize) -> Vec<f32> {
    let mut folded = vec![0.0; rows.batch * time * rows.channels];
    let samples = folded
        .chunks_mut(time * rows.channels)
        .enumerate()
        .collect();
    team::for_each_item(samples, |(sample, folded): (usize, &mut [f32])| {
        for (t, out) in folded.chunks_exact_mut(rows.channels).enumerate() {
            out.copy_from_slice(rows.row(sample, 2 * t));
            if 2 * t + 1 < rows.time {
                for (out, second) in out.iter_mut().zip(rows.row(sample, 2 * t + 1)) {
                    *out += second;
                }
            }
        }
    });
    folded
}

/// The sum of all rows, sample by sample.
pub(crate) fn column_sums(rows: Rows<'_>) -> Vec<f32> {
    let partial: Vec<Vec<f32>> = team::map(rows.batch, |sample| {
        let mut sums = vec![0.0; rows.channels];
        vectorized(
            #[inline(always)]
            || {
                for time in 0..rows.time {
                    for (sum, value) in sums.iter_mut().zip(rows.row(sample, time)) {
                        *sum += value;
                    }
                }
            },
        );
        sums
    });
    let mut total = vec![0.0; rows.channels];
    for sums in partial {
        for (total, sum) in total.iter_mut().zip(sums) {
            *total += sum;
        }
    }
    total
}
