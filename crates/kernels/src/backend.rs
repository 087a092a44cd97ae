//! The operations as a Burn backend extension, for Flex and for gradients on it.
//!
//! Burn's extension macro has no optional tensors: a placeholder is passed for a missing one, and
//! [`Options`] marks it as missing.

use std::borrow::Cow;

use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, backend_extension};

use crate::flex::{HostRows, contiguous, from_rows, of_elements, tensor, tensor_like};
use crate::host::attention::{Attended, Columns, Heads};
use crate::host::convolution::{ConvolutionPlan, Input};
use crate::host::gelu;
use crate::host::layer_norm::LayerNormRows;
use crate::host::norm::{self, GroupNormPlan, Norm, NormGradients, Statistics};
use crate::host::packed_cache;
use crate::host::product::Addends;
use crate::host::recurrence::{GruPlan, GruValues};
use crate::host::rows::{Rows, SharedRows, rows_written_by};
use crate::host::team;
use crate::lengths::{KeyRanges, Lengths};
use crate::linear_map::SharedMap;

/// The optional tensors that are present, sample lengths and attention ranges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// A convolution's bias.
    pub bias: bool,
    /// Addend of a convolution's output.
    pub residual: bool,
    /// Scale and shift after a normalization.
    pub film: bool,
    /// Factors after an activation.
    pub mask: bool,
    /// Valid frames of each sample; all by default.
    pub lengths: Option<Lengths>,
    /// Keys that each query attends to.
    pub keys: Option<KeyRanges>,
    /// Activation checkpointing computes the output again instead of storing it.
    pub recomputed: bool,
}

impl From<Option<&Lengths>> for Options {
    fn from(lengths: Option<&Lengths>) -> Self {
        Self {
            lengths: lengths.cloned(),
            ..Self::default()
        }
    }
}

impl Options {
    /// The keys that queries attend to.
    pub fn attended(&self) -> Attended<'_> {
        match (&self.keys, self.frames()) {
            (Some(ranges), _) => Attended::Ranges(ranges),
            (None, Some(lengths)) => Attended::First(lengths),
            (None, None) => Attended::All,
        }
    }

    /// The frames of each sample.
    pub fn frames(&self) -> Option<&[usize]> {
        self.lengths.as_ref().map(Lengths::frames)
    }
}

/// The fused operations.
#[allow(clippy::too_many_arguments)]
#[backend_extension(Flex, Autodiff)]
pub trait FusedOps: Backend {
    /// Applies a [`ConvolutionPlan`] to `x`; `norm_weight`, `norm_bias`, `film` and `mask` belong
    /// to its normalization.
    fn fused_convolution(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        norm_weight: FloatTensor<Self>,
        norm_bias: FloatTensor<Self>,
        film: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        plan: ConvolutionPlan,
        options: Options,
    ) -> FloatTensor<Self>;

    /// [`GroupNormPlan`] of `x`.
    fn fused_group_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        film: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        plan: GroupNormPlan,
        options: Options,
    ) -> FloatTensor<Self>;

    /// Attention of `[batch, channels, time]` to keys and values `[batch, 2 channels, keys]`.
    fn fused_cross_attention(
        queries: FloatTensor<Self>,
        keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self>;

    /// Attention of queries, keys and values `[batch, 3 channels, time]`.
    fn fused_self_attention(
        queries_keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self>;

    /// The channels of `first`, then those of `second`.
    fn concat_channels(first: FloatTensor<Self>, second: FloatTensor<Self>) -> FloatTensor<Self>;

    /// The states of a gated recurrent unit, `[time, batch, width]`.
    fn fused_gru(
        inputs: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        initial: FloatTensor<Self>,
        plan: GruPlan,
        options: Options,
    ) -> FloatTensor<Self>;

    /// Normalization of each row of `x`, `[rows, features]`.
    fn fused_layer_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        eps: f64,
    ) -> FloatTensor<Self>;

    /// GELU of each element.
    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self>;

    /// A linear map of each sample of `x`.
    fn fused_linear_map(x: FloatTensor<Self>, map: SharedMap) -> FloatTensor<Self>;

    /// `x`, stored with activation checkpointing.
    fn stored(x: FloatTensor<Self>) -> FloatTensor<Self>;
}

/// A normalization of one input.
#[derive(Clone, Debug)]
pub(crate) struct MeasuredNorm {
    plan: GroupNormPlan,
    /// Weight, bias, FiLM and mask.
    tensors: [FlexTensor; 4],
    statistics: Statistics,
}

impl MeasuredNorm {
    /// Measures `x`.
    pub fn new(
        x: Rows<'_>,
        plan: GroupNormPlan,
        tensors: [FlexTensor; 4],
        options: &Options,
    ) -> Self {
        Self {
            plan,
            tensors,
            statistics: norm::statistics(x, &plan, options.frames()),
        }
    }

    /// Calls `work` with the normalization as slices.
    pub fn slices<R>(&self, options: &Options, work: impl FnOnce(Norm<'_>) -> R) -> R {
        let [weight, bias, film, mask] = &self.tensors;
        let film = options.film.then(|| contiguous(film));
        let mask = options.mask.then(|| HostRows::of(mask.clone()));
        work(Norm {
            plan: self.plan,
            statistics: &self.statistics,
            weight: &contiguous(weight),
            bias: &contiguous(bias),
            film: film.as_deref(),
            mask: mask.as_ref().map(HostRows::view),
            lengths: options.frames(),
        })
    }
}

/// The gradients of a normalization's weight, bias and FiLM as tensors.
pub(crate) fn norm_gradients(gradients: NormGradients, batch: usize) -> [Option<FlexTensor>; 3] {
    let channels = gradients.weight.len();
    let film = gradients.film;
    [
        Some(tensor(gradients.weight, [channels])),
        Some(tensor(gradients.bias, [channels])),
        film.map(|values| tensor(values, [batch, 2 * channels])),
    ]
}

/// Calls `work` with the input of a convolution as slices.
pub(crate) fn with_input<R>(
    x: Rows<'_>,
    norm: Option<&MeasuredNorm>,
    options: &Options,
    work: impl FnOnce(Input<'_>) -> R,
) -> R {
    let lengths = options.frames();
    match norm {
        Some(norm) => norm.slices(options, |norm| {
            let norm = Some(norm);
            work(Input { x, norm, lengths })
        }),
        None => work(Input {
            x,
            norm: None,
            lengths,
        }),
    }
}

pub(crate) fn convolution(
    x: Rows<'_>,
    weight: &FlexTensor,
    bias: &FlexTensor,
    residual: FlexTensor,
    norm: Option<&MeasuredNorm>,
    plan: &ConvolutionPlan,
    options: &Options,
) -> FlexTensor {
    let shape = weight.layout().shape().dims();
    let residual = options.residual.then(|| HostRows::of(residual));
    let bias = options.bias.then(|| contiguous(bias));
    let addends = Addends {
        bias: bias.as_deref(),
        residual: residual.as_ref().map(HostRows::view),
    };
    let data = contiguous(weight);
    if let Cow::Borrowed(data) = data {
        packed_cache::allow(data, shape, || weight.clone());
    }
    let output = with_input(x, norm, options, |input| {
        plan.forward(input, &data, shape, addends)
    });
    from_rows(
        output,
        [x.batch, plan.frames(x.time), plan.out_channels(shape)],
    )
}

pub(crate) fn group_norm(x: Rows<'_>, norm: &MeasuredNorm, options: &Options) -> FlexTensor {
    let output = norm.slices(options, |norm| {
        // SAFETY: a normalization writes every element.
        #[allow(unsafe_code)]
        unsafe {
            rows_written_by(x.shape(), |rows| norm::forward(x, &norm, rows))
        }
    });
    from_rows(output, x.shape())
}

/// Heads of queries, and of keys and values side by side.
pub(crate) fn cross_heads<'a>(
    queries: Rows<'a>,
    keys_values: Rows<'a>,
    num_heads: usize,
    options: &'a Options,
) -> Heads<'a> {
    let channels = queries.channels;
    Heads {
        queries,
        keys: keys_values.narrow(0, channels),
        values: keys_values.narrow(channels, channels),
        num_heads,
        attended: options.attended(),
    }
}

/// Heads of queries, keys and values that lie side by side.
pub(crate) fn self_heads<'a>(all: Rows<'a>, num_heads: usize, options: &'a Options) -> Heads<'a> {
    let channels = all.channels / 3;
    Heads {
        queries: all.narrow(0, channels),
        keys: all.narrow(channels, channels),
        values: all.narrow(2 * channels, channels),
        num_heads,
        attended: options.attended(),
    }
}

pub(crate) fn attend(heads: Heads<'_>) -> FlexTensor {
    from_rows(heads.forward(), heads.queries.shape())
}

/// Gradients of queries, keys and values, in order, in tensors with these frames and numbers of
/// parts.
pub(crate) fn attend_backward<const N: usize>(
    heads: Heads<'_>,
    gradient: Rows<'_>,
    sizes: [(usize, usize); N],
) -> [FlexTensor; N] {
    let [batch, _, channels] = heads.queries.shape();
    let mut tensors = sizes.map(|(time, parts)| {
        let shape = [batch, time, parts * channels];
        (vec![0.0; shape.iter().product()], shape)
    });
    let columns = tensors.iter_mut().zip(sizes);
    let mut columns = columns.flat_map(|((values, shape), (_, parts))| {
        let rows = SharedRows::dense(values, *shape);
        (0..parts).map(move |part| Columns {
            rows,
            first: part * channels,
        })
    });
    let into = [(); 3].map(|()| columns.next().expect("three parts"));
    heads.backward(gradient, into);
    tensors.map(|(values, shape)| from_rows(values, shape))
}

/// `map` of each sample of `x`, `[batch, channels, time]`, to these channels and frames.
pub(crate) fn mapped(
    x: &FlexTensor,
    [channels, time]: [usize; 2],
    map: impl Fn(&[f32], &mut [f32]) + Sync,
) -> FlexTensor {
    let [batch, from_channels, from_time] = x.layout().shape().dims();
    let values = contiguous(x);
    let mut into = vec![0.0; batch * channels * time];
    let samples = into
        .chunks_mut(channels * time)
        .zip(values.chunks(from_channels * from_time));
    team::for_each_item(samples.collect(), |(into, from): (&mut [f32], &[f32])| {
        map(from, into);
    });
    tensor(into, [batch, channels, time])
}

/// Calls `work` with the inputs, weight, bias and initial state of a recurrent layer as slices.
pub(crate) fn with_gru_values<R>(
    tensors: &[FlexTensor; 4],
    options: &Options,
    work: impl FnOnce(&GruValues<'_>) -> R,
) -> R {
    let [inputs, weight, bias, initial] = tensors.each_ref().map(contiguous);
    work(&GruValues {
        inputs: &inputs,
        weight: &weight,
        bias: &bias,
        initial: &initial,
        lengths: options.frames(),
    })
}

impl FusedOps for Flex {
    fn fused_convolution(
        x: FlexTensor,
        weight: FlexTensor,
        bias: FlexTensor,
        residual: FlexTensor,
        norm_weight: FlexTensor,
        norm_bias: FlexTensor,
        film: FlexTensor,
        mask: FlexTensor,
        plan: ConvolutionPlan,
        options: Options,
    ) -> FlexTensor {
        let x = HostRows::of(x);
        let norm = [norm_weight, norm_bias, film, mask];
        let norm = plan
            .norm
            .map(|plan| MeasuredNorm::new(x.view(), plan, norm, &options));
        let norm = norm.as_ref();
        convolution(x.view(), &weight, &bias, residual, norm, &plan, &options)
    }

    fn fused_group_norm(
        x: FlexTensor,
        weight: FlexTensor,
        bias: FlexTensor,
        film: FlexTensor,
        mask: FlexTensor,
        plan: GroupNormPlan,
        options: Options,
    ) -> FlexTensor {
        let x = HostRows::of(x);
        let norm = MeasuredNorm::new(x.view(), plan, [weight, bias, film, mask], &options);
        group_norm(x.view(), &norm, &options)
    }

    fn fused_cross_attention(
        queries: FlexTensor,
        keys_values: FlexTensor,
        num_heads: usize,
        options: Options,
    ) -> FlexTensor {
        let (queries, keys_values) = (HostRows::of(queries), HostRows::of(keys_values));
        let (queries, keys_values) = (queries.view(), keys_values.view());
        attend(cross_heads(queries, keys_values, num_heads, &options))
    }

    fn fused_self_attention(
        queries_keys_values: FlexTensor,
        num_heads: usize,
        options: Options,
    ) -> FlexTensor {
        let all = HostRows::of(queries_keys_values);
        attend(self_heads(all.view(), num_heads, &options))
    }

    fn fused_gru(
        inputs: FlexTensor,
        weight: FlexTensor,
        bias: FlexTensor,
        initial: FlexTensor,
        plan: GruPlan,
        options: Options,
    ) -> FlexTensor {
        let tensors = [inputs, weight, bias, initial];
        let (states, _) = with_gru_values(&tensors, &options, |values| plan.forward(values, false));
        tensor(states, [plan.time, plan.batch, plan.width])
    }

    fn fused_layer_norm(
        x: FlexTensor,
        weight: FlexTensor,
        bias: FlexTensor,
        eps: f64,
    ) -> FlexTensor {
        let rows = LayerNormRows {
            x: &contiguous(&x),
            weight: &contiguous(&weight),
            eps,
        };
        tensor_like(rows.forward(&contiguous(&bias)), &x)
    }

    fn fused_gelu(x: FlexTensor) -> FlexTensor {
        of_elements(&x, gelu::forward)
    }

    fn fused_linear_map(x: FlexTensor, map: SharedMap) -> FlexTensor {
        let [_, channels, time] = x.layout().shape().dims();
        mapped(&x, map.shape(channels, time), |from, into| {
            map.apply(from, into);
        })
    }

    fn concat_channels(first: FlexTensor, second: FlexTensor) -> FlexTensor {
        let (first, second) = (HostRows::of(first), HostRows::of(second));
        let (first, second) = (first.view(), second.view());
        let channels = first.channels + second.channels;
        let mut rows = vec![0.0; first.batch * first.time * channels];
        let samples = rows.chunks_mut(first.time * channels).enumerate().collect();
        team::for_each_item(samples, |(sample, rows): (usize, &mut [f32])| {
            for (time, row) in rows.chunks_exact_mut(channels).enumerate() {
                let (left, right) = row.split_at_mut(first.channels);
                left.copy_from_slice(first.row(sample, time));
                right.copy_from_slice(second.row(sample, time));
            }
        });
        from_rows(rows, [first.batch, first.time, channels])
    }

    fn stored(x: FlexTensor) -> FlexTensor {
        x
    }
}
