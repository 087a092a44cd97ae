//! The operations composed of Burn's operations, for every device.

use std::ops::Range;

use burn::tensor::Tensor;
use burn::tensor::activation::{mish, silu};

use crate::{Activation, Convolution, GroupNorm, KeyRanges, Lengths, product};

pub(crate) fn group_norm(x: Tensor<3>, norm: GroupNorm) -> Tensor<3> {
    let [batch, channels, time] = x.dims();
    let (groups, eps) = (norm.plan.groups, norm.plan.eps);
    let grouped = [batch, groups, channels / groups * time];
    let padding = norm.lengths.map(|lengths| {
        let device = x.device();
        let mask = lengths.mask(time, &device);
        let counts = lengths
            .counts(&device)
            .mul_scalar((channels / groups) as f64);
        (mask, counts)
    });
    let x = match &padding {
        Some((mask, counts)) => {
            let spread = mask
                .clone()
                .expand([batch, channels, time])
                .reshape(grouped);
            let x = x.reshape(grouped) * spread.clone();
            let mean = x.clone().sum_dim(2) / counts.clone();
            let x = (x - mean) * spread;
            let variance = x.clone().square().sum_dim(2) / counts.clone();
            x / variance.add_scalar(eps).sqrt()
        }
        None => {
            let x = x.reshape(grouped);
            let x = x.clone() - x.mean_dim(2);
            let variance = x.clone().square().mean_dim(2);
            x / variance.add_scalar(eps).sqrt()
        }
    };
    let per_channel = |p: Tensor<1>| p.reshape([1, channels, 1]);
    let x = x.reshape([batch, channels, time]) * per_channel(norm.weight) + per_channel(norm.bias);
    let x = match norm.film {
        Some(film) => {
            let part = |first| {
                film.clone()
                    .narrow(1, first, channels)
                    .unsqueeze_dim::<3>(2)
            };
            x * part(0).add_scalar(1.0) + part(channels)
        }
        None => x,
    };
    let x = match norm.plan.activation {
        Activation::None => x,
        Activation::Silu => silu(x),
        Activation::Mish => mish(x),
    };
    let x = match norm.mask {
        Some(mask) => x * mask,
        None => x,
    };
    match padding {
        Some((mask, _)) => x * mask,
        None => x,
    }
}

pub(crate) fn convolution(x: Tensor<3>, convolution: Convolution) -> Tensor<3> {
    let Convolution {
        weight,
        bias,
        residual,
        norm,
        geometry,
        transposed,
        upsample,
        lengths,
        // Burn's operations have their own checkpointing.
        recomputed: _,
    } = convolution;
    let x = match norm {
        Some(norm) => group_norm(x, norm),
        None => x,
    };
    let x = match upsample {
        Some(frames) => upsample_nearest(x, frames),
        None => x,
    };
    let x = match lengths {
        Some(lengths) => {
            let mask = lengths.mask(x.dims()[2], &x.device());
            x * mask
        }
        None => x,
    };
    let y = if transposed {
        // A transposed convolution inserts zeros between the frames and flips the kernel.
        let padding = geometry.kernel - 1 - geometry.padding;
        let weight = weight.swap_dims(0, 1).flip([2]);
        multiply_windows(spread(x, geometry.stride), weight, padding, 1)
    } else {
        multiply_windows(x, weight, geometry.padding, geometry.stride)
    };
    let y = match bias {
        Some(bias) => {
            let channels = y.dims()[1];
            y + bias.reshape([1, channels, 1])
        }
        None => y,
    };
    match residual {
        Some(residual) => y + residual,
        None => y,
    }
}

/// A convolution as one matrix product over batch and time, which is faster on Burn's CPU backends
/// than their convolution.
///
/// # Shapes
/// - x: `[batch, in, time]`, weight: `[out, in, kernel]`
/// - output: `[batch, out, frames]`
fn multiply_windows(x: Tensor<3>, weight: Tensor<3>, padding: usize, stride: usize) -> Tensor<3> {
    let [batch, inputs, time] = x.dims();
    let [outputs, _, kernel] = weight.dims();
    let windows = time + 2 * padding + 1 - kernel;
    let frames = windows.div_ceil(stride);

    // Row (b, t) contains the inputs of output frame t of sample b.
    let rows = x.swap_dims(1, 2);
    let columns = if kernel == 1 && stride == 1 {
        rows
    } else {
        let edge = Tensor::zeros([batch, padding, inputs], &rows.device());
        let padded = Tensor::cat(vec![edge.clone(), rows, edge], 1);
        let tap = |k: usize| every(padded.clone().narrow(1, k, windows), stride);
        Tensor::cat((0..kernel).map(tap).collect(), 2)
    };
    let columns = columns.reshape([batch * frames, kernel * inputs]);
    let weight = weight
        .permute([2, 1, 0])
        .reshape([kernel * inputs, outputs]);
    product(columns, weight)
        .reshape([batch, frames, outputs])
        .swap_dims(1, 2)
}

/// Every `stride`-th frame of `[batch, time, channels]`, the first included.
fn every(rows: Tensor<3>, stride: usize) -> Tensor<3> {
    let [batch, time, channels] = rows.dims();
    if stride == 1 {
        return rows;
    }
    let frames = time.div_ceil(stride);
    let missing = frames * stride - time;
    let rows = if missing == 0 {
        rows
    } else {
        let edge = Tensor::zeros([batch, missing, channels], &rows.device());
        Tensor::cat(vec![rows, edge], 1)
    };
    rows.reshape([batch, frames, stride * channels])
        .narrow(2, 0, channels)
}

/// `stride - 1` zeros between the frames of `[batch, channels, time]`.
fn spread(x: Tensor<3>, stride: usize) -> Tensor<3> {
    let [batch, channels, time] = x.dims();
    if stride == 1 {
        return x;
    }
    let zeros = Tensor::zeros([batch, channels, time, stride - 1], &x.device());
    Tensor::cat(vec![x.unsqueeze_dim::<4>(3), zeros], 3)
        .reshape([batch, channels, time * stride])
        .narrow(2, 0, (time - 1) * stride + 1)
}

/// Repeats every frame of `[batch, channels, time]` twice and keeps the first `frames`.
fn upsample_nearest(x: Tensor<3>, frames: usize) -> Tensor<3> {
    let [batch, channels, time] = x.dims();
    let doubled = x
        .unsqueeze_dim::<4>(3)
        .expand([batch, channels, time, 2])
        .reshape([batch, channels, 2 * time]);
    if frames == 2 * time {
        doubled
    } else {
        doubled.narrow(2, 0, frames)
    }
}

/// Scaled dot-product attention; queries `[batch, channels, time]`, keys and values `[batch,
/// channels, keys]`, the first `lengths` of each sample unmasked.
pub(crate) fn attention(
    queries: Tensor<3>,
    keys: Tensor<3>,
    values: Tensor<3>,
    num_heads: usize,
    lengths: Option<&Lengths>,
) -> Tensor<3> {
    let mask = lengths.map(|lengths| {
        let mask = lengths.mask(keys.dims()[2], &queries.device());
        mask.unsqueeze_dim::<4>(1)
    });
    masked(queries, keys, values, num_heads, mask)
}

/// [`attention`] of each query to a range of keys. Queries of narrow ranges are processed in parts.
pub(crate) fn ranged_attention(
    queries: Tensor<3>,
    keys: Tensor<3>,
    values: Tensor<3>,
    num_heads: usize,
    ranges: &KeyRanges,
) -> Tensor<3> {
    let [batch, _, time] = queries.dims();
    let length = match 2 * ranges.widest() < keys.dims()[2] {
        true => ranges.widest().max(SHORTEST_PART),
        false => time,
    };
    let part = |start: usize| {
        let part = start..time.min(start + length);
        let spans = (0..batch).map(|sample| ranges.span(sample, part.clone()));
        let spans = spans.filter(|span| !span.is_empty());
        let span = spans.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end));
        // A part without keys gets one masked key, whose zeros stay part of the graph.
        let span = span.unwrap_or(0..1);
        let of =
            |x: &Tensor<3>, frames: &Range<usize>| x.clone().narrow(2, frames.start, frames.len());
        let mask = ranges.mask(part.clone(), span.clone(), &queries.device());
        masked(
            of(&queries, &part),
            of(&keys, &span),
            of(&values, &span),
            num_heads,
            Some(mask),
        )
    };
    Tensor::cat((0..time).step_by(length).map(part).collect(), 2)
}

/// Minimum number of queries of a part.
const SHORTEST_PART: usize = if cfg!(test) { 2 } else { 64 };

/// Attention under a mask `[batch, 1, 1 or time, keys]`; a query without a key gives zeros.
fn masked(
    queries: Tensor<3>,
    keys: Tensor<3>,
    values: Tensor<3>,
    num_heads: usize,
    mask: Option<Tensor<4>>,
) -> Tensor<3> {
    let [batch, channels, time] = queries.dims();
    let head_channels = channels / num_heads;
    let heads = |x: Tensor<3>| {
        let frames = x.dims()[2];
        x.reshape([batch, num_heads, head_channels, frames])
    };
    let scale = (head_channels as f64).powf(-0.5);
    let scores = product(heads(queries).swap_dims(2, 3), heads(keys)).mul_scalar(scale);
    let weights = match mask {
        // Hidden scores are far below every score, and finite: the weight is exactly 0 after the
        // softmax.
        Some(mask) => {
            let hidden = mask.clone().sub_scalar(1.0).mul_scalar(1e9);
            softmax(scores + hidden) * mask
        }
        None => softmax(scores),
    };
    product(heads(values), weights.swap_dims(2, 3)).reshape([batch, channels, time])
}

/// Softmax over the last dimension, from primitives. Burn's softmax is fused without gradients and
/// then differs in the last bits, but a rollout recomputed for its gradient must repeat exactly.
fn softmax(scores: Tensor<4>) -> Tensor<4> {
    let largest = scores.clone().without_autodiff().max_dim(3);
    let exponentials = (scores - largest).exp();
    let sum = exponentials.clone().sum_dim(3);
    exponentials / sum
}
