//! The operations as a Burn backend extension, for Flex and for gradients on it.
//!
//! Burn's extension macro has no optional tensors: a placeholder is passed for a missing one, and
//! [`Options`] marks it as missing.

use std::borrow::Cow;

use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, backend_extension};

use crate::flex::{HostRows, contiguous, from_rows, of_elements, tensor};
use crate::host::attention::{Attended, Columns, HeadGradients, Heads};
use crate::host::convolution::{ConvolutionPlan, Input};
use crate::host::gelu;
use crate::host::layer_norm::LayerNormRows;
use crate::host::norm::{self, GroupNormPlan, NormGradients, NormParameters, Statistics};
use crate::host::packed_cache;
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
    /// Scale and shift after a normalisation.
    pub film: bool,
    /// Factors after an activation.
    pub mask: bool,
    /// Valid frames of each sample; all by default.
    pub lengths: Option<Lengths>,
    /// Keys that each query attends to.
    pub keys: Option<KeyRanges>,
}

impl Options {
    /// The keys that are attended to.
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
    /// [`ConvolutionPlan`] of `x`, whose normalisation has the parameters `norm_weight`,
    /// `norm_bias`, `film` and `mask`.
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

    /// Attention of queries `[batch, channels, time]` to keys and values `[batch, 2 channels, keys]`.
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

    /// Normalisation of each row of `x`, `[rows, features]`.
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
}

/// The tensors of a normalisation on the host.
pub(crate) struct HostNorm {
    weight: FlexTensor,
    bias: FlexTensor,
    film: Option<FlexTensor>,
    mask: Option<HostRows>,
    lengths: Option<Lengths>,
}

impl HostNorm {
    pub fn new(
        [weight, bias, film]: [&FlexTensor; 3],
        mask: &FlexTensor,
        options: &Options,
    ) -> Self {
        Self {
            weight: weight.to_contiguous(),
            bias: bias.to_contiguous(),
            film: options.film.then(|| film.to_contiguous()),
            mask: options.mask.then(|| HostRows::of(mask.clone())),
            lengths: options.lengths.clone(),
        }
    }

    pub fn parameters(&self) -> NormParameters<'_> {
        NormParameters {
            weight: self.weight.as_slice().expect("float32, contiguous"),
            bias: self.bias.as_slice().expect("float32, contiguous"),
            film: self
                .film
                .as_ref()
                .map(|film| film.as_slice().expect("float32, contiguous")),
            mask: self.mask.as_ref().map(HostRows::view),
            lengths: self.lengths.as_ref().map(Lengths::frames),
        }
    }
}

/// The gradients of a normalisation's weight, bias and FiLM as tensors.
pub(crate) fn norm_gradients(
    gradients: NormGradients,
    film: [usize; 2],
) -> [Option<FlexTensor>; 3] {
    let channels = gradients.weight.len();
    [
        Some(tensor(gradients.weight, [channels])),
        Some(tensor(gradients.bias, [channels])),
        gradients.film.map(|values| tensor(values, film)),
    ]
}

pub(crate) fn convolution(
    x: Rows<'_>,
    weight: &FlexTensor,
    bias: Option<&FlexTensor>,
    residual: Option<FlexTensor>,
    norm: Option<(&Statistics, &HostNorm)>,
    plan: &ConvolutionPlan,
    lengths: Option<&[usize]>,
) -> FlexTensor {
    let shape = weight.layout().shape().dims();
    let residual = residual.map(HostRows::of);
    let bias = bias.map(contiguous);
    let input = Input {
        x,
        norm: norm.map(|(statistics, norm)| (statistics, norm.parameters())),
        lengths,
    };
    let data = contiguous(weight);
    if let Cow::Borrowed(data) = data {
        packed_cache::allow(data, shape, || weight.clone());
    }
    let output = plan.forward(
        input,
        &data,
        shape,
        bias.as_deref(),
        residual.as_ref().map(HostRows::view),
    );
    from_rows(
        output,
        [x.batch, plan.frames(x.time), plan.out_channels(shape)],
    )
}

pub(crate) fn group_norm(
    x: Rows<'_>,
    statistics: &Statistics,
    norm: &HostNorm,
    plan: &GroupNormPlan,
) -> FlexTensor {
    let shape = [x.batch, x.time, x.channels];
    // SAFETY: a normalisation writes every element.
    #[allow(unsafe_code)]
    let output = unsafe {
        rows_written_by(shape, |rows| {
            norm::forward(x, statistics, plan, &norm.parameters(), rows);
        })
    };
    from_rows(output, shape)
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

/// Heads of queries, keys and values side by side.
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
    let shape = [
        heads.queries.batch,
        heads.queries.time,
        heads.queries.channels,
    ];
    from_rows(heads.forward(), shape)
}

/// Gradients of the queries, and of the keys and values side by side.
pub(crate) fn attend_backward(heads: Heads<'_>, gradient: Rows<'_>) -> [FlexTensor; 2] {
    let Rows {
        batch,
        time,
        channels,
        ..
    } = heads.queries;
    let keys = heads.keys.time;
    let (mut queries, mut keys_values) = (
        vec![0.0; batch * time * channels],
        vec![0.0; batch * keys * 2 * channels],
    );
    let query_rows = SharedRows::dense(&mut queries, [batch, time, channels]);
    let rows = SharedRows::dense(&mut keys_values, [batch, keys, 2 * channels]);
    heads.backward(
        gradient,
        HeadGradients {
            queries: Columns {
                rows: query_rows,
                first: 0,
            },
            keys: Columns { rows, first: 0 },
            values: Columns {
                rows,
                first: channels,
            },
        },
    );
    [
        from_rows(queries, [batch, time, channels]),
        from_rows(keys_values, [batch, keys, 2 * channels]),
    ]
}

/// Gradient of queries, keys and values side by side.
pub(crate) fn self_attend_backward(heads: Heads<'_>, gradient: Rows<'_>) -> FlexTensor {
    let Rows {
        batch,
        time,
        channels,
        ..
    } = heads.queries;
    let shape = [batch, time, 3 * channels];
    let mut all = vec![0.0; shape.iter().product()];
    let rows = SharedRows::dense(&mut all, shape);
    let columns = |part: usize| Columns {
        rows,
        first: part * channels,
    };
    let into = HeadGradients {
        queries: columns(0),
        keys: columns(1),
        values: columns(2),
    };
    heads.backward(gradient, into);
    from_rows(all, shape)
}

/// `map` of each sample of `x`, `[batch, channels, time]`, to a sample of these channels and frames.
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

/// The states of a gated recurrent unit and, with `save`, the gates for its backward pass.
pub(crate) fn recur(
    [inputs, weight, bias, initial]: [&FlexTensor; 4],
    plan: &GruPlan,
    options: &Options,
    save: bool,
) -> (Vec<f32>, Vec<f32>) {
    let values = GruValues {
        inputs: &contiguous(inputs),
        weight: &contiguous(weight),
        bias: &contiguous(bias),
        initial: &contiguous(initial),
        lengths: options.frames(),
    };
    plan.forward(&values, save)
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
        let norm = plan.norm.map(|plan| {
            let parameters = [&norm_weight, &norm_bias, &film];
            (
                norm::statistics(x.view(), &plan, options.frames()),
                HostNorm::new(parameters, &mask, &options),
            )
        });
        convolution(
            x.view(),
            &weight,
            options.bias.then_some(&bias),
            options.residual.then_some(residual),
            norm.as_ref().map(|(statistics, norm)| (statistics, norm)),
            &plan,
            options.frames(),
        )
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
        let norm = HostNorm::new([&weight, &bias, &film], &mask, &options);
        let statistics = norm::statistics(x.view(), &plan, options.frames());
        group_norm(x.view(), &statistics, &norm, &plan)
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
        let (states, _) = recur([&inputs, &weight, &bias, &initial], &plan, &options, false);
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
        let values = rows.forward(&contiguous(&bias));
        tensor(values, x.layout().shape().clone())
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
}
