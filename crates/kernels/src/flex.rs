//! Burn's CPU tensors as rows, and rows as tensors.

use std::borrow::Cow;

use burn::backend::flex::{FlexTensor, Layout};
use burn::tensor::{Bytes, DType, Shape};

use crate::host::rows::Rows;
use crate::host::team;

/// The frames of `[batch, channels, time]`, copied only if the channels are not contiguous.
pub(crate) struct HostRows {
    tensor: FlexTensor,
    shape: [usize; 3],
    strides: [usize; 2],
}

impl HostRows {
    /// # Panics
    /// Panics unless the tensor is float32 and has three dimensions.
    pub fn of(tensor: FlexTensor) -> Self {
        let layout = tensor.layout();
        let [batch, channels, time] = layout.shape().dims();
        let strides: Option<Vec<usize>> = layout
            .strides()
            .iter()
            .map(|&s| usize::try_from(s).ok())
            .collect();
        match strides.as_deref() {
            Some(&[sample, channel, row]) if channel == 1 || channels == 1 => Self {
                shape: [batch, time, channels],
                strides: [sample, row],
                tensor,
            },
            _ => Self::of(from_rows(transposed(&tensor), [batch, time, channels])),
        }
    }

    pub fn view(&self) -> Rows<'_> {
        let [batch, time, channels] = self.shape;
        let [sample_stride, row_stride] = self.strides;
        Rows {
            data: &self.tensor.storage::<f32>()[self.tensor.layout().start_offset()..],
            batch,
            time,
            channels,
            sample_stride,
            row_stride,
        }
    }
}

/// `[batch, time, channels]` without gaps, of a tensor `[batch, channels, time]` of any layout.
fn transposed(tensor: &FlexTensor) -> Vec<f32> {
    const BLOCK: usize = 16;
    let tensor = tensor.to_contiguous();
    let [_, channels, time] = tensor.layout().shape().dims();
    let from = contiguous(&tensor);
    let mut rows = vec![0.0; from.len()];
    let samples = rows
        .chunks_mut(time * channels)
        .zip(from.chunks(time * channels));
    team::for_each_item(samples.collect(), |(rows, from): (&mut [f32], &[f32])| {
        for t0 in (0..time).step_by(BLOCK) {
            for c in 0..channels {
                let line = &from[c * time..(c + 1) * time];
                for t in t0..(t0 + BLOCK).min(time) {
                    rows[t * channels + c] = line[t];
                }
            }
        }
    });
    rows
}

/// The elements in row-major order, copied only if the layout is another.
pub(crate) fn contiguous(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => {
            let tensor = tensor.to_contiguous();
            Cow::Owned(
                tensor
                    .as_slice::<f32>()
                    .expect("float32, contiguous")
                    .to_vec(),
            )
        }
    }
}

/// The elements in memory order, if there are neither gaps nor broadcast elements.
pub(crate) fn in_memory_order(tensor: &FlexTensor) -> Option<&[f32]> {
    let layout = tensor.layout();
    let mut axes: Vec<(isize, usize)> = layout
        .strides()
        .iter()
        .copied()
        .zip(layout.shape().iter().copied())
        .filter(|(_, size)| *size != 1)
        .collect();
    axes.sort_unstable();
    let mut elements = 1;
    for (stride, size) in axes {
        if usize::try_from(stride) != Ok(elements) {
            return None;
        }
        elements *= size;
    }
    Some(&tensor.storage::<f32>()[layout.start_offset()..][..elements])
}

/// Applies `of` to each element of `x`; the result has the memory order of `x` if `x` has no gaps.
pub(crate) fn of_elements(x: &FlexTensor, of: impl Fn(&[f32]) -> Vec<f32>) -> FlexTensor {
    match in_memory_order(x) {
        Some(values) => laid_out(of(values), x),
        None => tensor_like(of(&contiguous(x)), x),
    }
}

/// [`of_elements`] of two tensors of one shape.
pub(crate) fn of_pairs(
    x: &FlexTensor,
    other: &FlexTensor,
    of: impl Fn(&[f32], &[f32]) -> Vec<f32>,
) -> FlexTensor {
    match (in_memory_order(x), in_memory_order(other)) {
        (Some(a), Some(b)) if same_order(x, other) => laid_out(of(a, b), x),
        _ => tensor_like(of(&contiguous(x), &contiguous(other)), x),
    }
}

fn same_order(a: &FlexTensor, b: &FlexTensor) -> bool {
    let (a, b) = (a.layout(), b.layout());
    let strides = a.strides().iter().zip(b.strides());
    let mut axes = a.shape().iter().zip(strides);
    a.shape() == b.shape() && axes.all(|(&size, (a, b))| size == 1 || a == b)
}

/// A tensor of the layout of `like`, whose elements are in memory order.
fn laid_out(values: Vec<f32>, like: &FlexTensor) -> FlexTensor {
    let layout = like.layout();
    let strides = layout.strides().to_vec();
    FlexTensor::new(
        Bytes::from_elems(values),
        Layout::new(layout.shape().clone(), strides, 0),
        DType::F32,
    )
}

/// A tensor of row-major elements.
pub(crate) fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::new(
        Bytes::from_elems(values),
        Layout::contiguous(shape.into()),
        DType::F32,
    )
}

/// A tensor of row-major elements in the shape of `like`.
pub(crate) fn tensor_like(values: Vec<f32>, like: &FlexTensor) -> FlexTensor {
    tensor(values, like.layout().shape().clone())
}

/// A tensor `[batch, channels, time]` whose memory is the rows `[batch, time, channels]`.
pub(crate) fn from_rows(rows: Vec<f32>, [batch, time, channels]: [usize; 3]) -> FlexTensor {
    let shape = Shape::from([batch, channels, time]);
    let strides = vec![(time * channels) as isize, 1, channels as isize];
    FlexTensor::new(
        Bytes::from_elems(rows),
        Layout::new(shape, strides, 0),
        DType::F32,
    )
}
