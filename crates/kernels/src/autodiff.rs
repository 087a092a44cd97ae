//! Backward passes of the operations.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Flex};

use crate::backend::{
    FusedOps, HostNorm, Options, attend_backward, convolution, cross_heads, group_norm, mapped,
    norm_gradients, recur, self_attend_backward, self_heads,
};
use crate::flex::{HostRows, contiguous, from_rows, of_pairs, tensor};
use crate::host::convolution::{ConvolutionPlan, Input, Wanted};
use crate::host::gelu;
use crate::host::layer_norm::LayerNormRows;
use crate::host::norm::{self, GroupNormPlan, Statistics};
use crate::host::recurrence::{GruPlan, GruValues};
use crate::linear_map::SharedMap;

/// State of a convolution's backward pass.
#[derive(Clone, Debug)]
struct ConvolutionState {
    x: FlexTensor,
    weight: FlexTensor,
    /// Weight, bias, FiLM and mask of the normalisation, and the statistics of its input.
    norm: Option<([FlexTensor; 4], Statistics)>,
    plan: ConvolutionPlan,
    options: Options,
}

#[derive(Debug)]
struct Convolution;

impl Backward<Flex, 7> for Convolution {
    type State = ConvolutionState;

    fn backward(self, ops: Ops<Self::State, 7>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let ConvolutionState {
            x,
            weight,
            norm,
            plan,
            options,
        } = ops.state;
        let [
            x_node,
            weight_node,
            bias_node,
            residual_node,
            ref norm_nodes @ ..,
        ] = ops.parents;
        let gradient = gradients.consume::<Flex>(&ops.node);
        let norm_wanted = norm.is_some() && norm_nodes.iter().any(Option::is_some);
        let wanted = Wanted {
            input: x_node.is_some() || norm_wanted,
            weight: weight_node.is_some(),
            bias: options.bias && bias_node.is_some(),
        };

        let x_shape = x.layout().shape().dims::<3>();
        let weight_shape = weight.layout().shape().dims::<3>();
        let rows = HostRows::of(x);
        let gradient_rows = HostRows::of(gradient.clone());
        let host_norm = norm
            .as_ref()
            .map(|([weight, bias, film, mask], statistics)| {
                (
                    statistics,
                    HostNorm::new([weight, bias, film], mask, &options),
                )
            });
        let input = Input {
            x: rows.view(),
            norm: host_norm
                .as_ref()
                .map(|(statistics, norm)| (*statistics, norm.parameters())),
            lengths: options.frames(),
        };
        let computed = plan.backward(
            input,
            &contiguous(&weight),
            weight_shape,
            gradient_rows.view(),
            wanted,
        );

        let [batch, channels, time] = x_shape;
        if let (Some(node), Some(values)) = (x_node, computed.input) {
            let value = from_rows(values, [batch, time, channels]);
            gradients.register::<Flex>(node.id, value);
        }
        if let (Some(node), Some(values)) = (weight_node, computed.weight) {
            gradients.register::<Flex>(node.id, tensor(values, weight_shape));
        }
        if let (Some(node), Some(values)) = (bias_node, computed.bias) {
            let outputs = values.len();
            gradients.register::<Flex>(node.id, tensor(values, [outputs]));
        }
        if let (Some(node), true) = (residual_node, options.residual) {
            gradients.register::<Flex>(node.id, gradient);
        }
        if let Some(computed) = computed.norm {
            let values = norm_gradients(computed, [batch, 2 * channels]);
            for (node, value) in norm_nodes.iter().zip(values) {
                if let (Some(node), Some(value)) = (node, value) {
                    gradients.register::<Flex>(node.id, value);
                }
            }
        }
    }
}

/// State of a normalisation's backward pass.
#[derive(Clone, Debug)]
struct NormState {
    x: FlexTensor,
    parameters: [FlexTensor; 4],
    statistics: Statistics,
    plan: GroupNormPlan,
    options: Options,
}

#[derive(Debug)]
struct GroupNorm;

impl Backward<Flex, 4> for GroupNorm {
    type State = NormState;

    fn backward(self, ops: Ops<Self::State, 4>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let NormState {
            x,
            parameters,
            statistics,
            plan,
            options,
        } = ops.state;
        let [x_node, norm_nodes @ ..] = ops.parents;
        let gradient = HostRows::of(gradients.consume::<Flex>(&ops.node));
        let x = HostRows::of(x);
        let [weight, bias, film, mask] = &parameters;
        let norm = HostNorm::new([weight, bias, film], mask, &options);
        let view = x.view();
        let shape = [view.batch, view.time, view.channels];
        let mut values: Vec<f32> = gradient.view().to_dense();
        let computed = norm::backward(view, &statistics, &plan, &norm.parameters(), &mut values);
        if let Some(node) = x_node {
            gradients.register::<Flex>(node.id, from_rows(values, shape));
        }
        let values = norm_gradients(computed, [shape[0], 2 * shape[2]]);
        for (node, value) in norm_nodes.iter().zip(values) {
            if let (Some(node), Some(value)) = (node, value) {
                gradients.register::<Flex>(node.id, value);
            }
        }
    }
}

#[derive(Debug)]
struct LayerNorm;

impl Backward<Flex, 3> for LayerNorm {
    /// Rows, scales and eps.
    type State = (FlexTensor, FlexTensor, f64);

    fn backward(self, ops: Ops<Self::State, 3>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (x, weight, eps) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node);
        let rows = LayerNormRows {
            x: &contiguous(&x),
            weight: &contiguous(&weight),
            eps,
        };
        let computed = rows.backward(&contiguous(&gradient));
        let of_feature = weight.layout().shape().clone();
        let values = [
            (computed.x, x.layout().shape().clone()),
            (computed.weight, of_feature.clone()),
            (computed.bias, of_feature),
        ];
        for (node, (values, shape)) in ops.parents.into_iter().zip(values) {
            if let Some(node) = node {
                gradients.register::<Flex>(node.id, tensor(values, shape));
            }
        }
    }
}

#[derive(Debug)]
struct CrossAttention;

impl Backward<Flex, 2> for CrossAttention {
    type State = (FlexTensor, FlexTensor, usize, Options);

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (queries, keys_values, num_heads, options) = ops.state;
        let gradient = HostRows::of(gradients.consume::<Flex>(&ops.node));
        let (queries, keys_values) = (HostRows::of(queries), HostRows::of(keys_values));
        let (queries, keys_values) = (queries.view(), keys_values.view());
        let heads = cross_heads(queries, keys_values, num_heads, &options);
        let values = attend_backward(heads, gradient.view());
        for (node, value) in ops.parents.into_iter().zip(values) {
            if let Some(node) = node {
                gradients.register::<Flex>(node.id, value);
            }
        }
    }
}

#[derive(Debug)]
struct SelfAttention;

impl Backward<Flex, 1> for SelfAttention {
    type State = (FlexTensor, usize, Options);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (all, num_heads, options) = ops.state;
        let gradient = HostRows::of(gradients.consume::<Flex>(&ops.node));
        let all = HostRows::of(all);
        let heads = self_heads(all.view(), num_heads, &options);
        let value = self_attend_backward(heads, gradient.view());
        if let [Some(node)] = ops.parents {
            gradients.register::<Flex>(node.id, value);
        }
    }
}

#[derive(Debug)]
struct Concat;

impl Backward<Flex, 2> for Concat {
    type State = [usize; 2];

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let gradient = gradients.consume::<Flex>(&ops.node);
        let mut first = 0;
        for (node, channels) in ops.parents.into_iter().zip(ops.state) {
            if let Some(node) = node {
                // A view: the kernels read channels that lie within wider rows.
                let layout = gradient.layout().narrow(1, first, channels);
                gradients.register::<Flex>(node.id, gradient.clone().with_layout(layout));
            }
            first += channels;
        }
    }
}

/// State of a recurrent layer's backward pass.
#[derive(Clone, Debug)]
struct GruState {
    inputs: FlexTensor,
    weight: FlexTensor,
    bias: FlexTensor,
    initial: FlexTensor,
    states: FlexTensor,
    gates: Vec<f32>,
    plan: GruPlan,
    options: Options,
}

#[derive(Debug)]
struct Gru;

impl Backward<Flex, 4> for Gru {
    type State = GruState;

    fn backward(self, ops: Ops<Self::State, 4>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let GruState {
            inputs,
            weight,
            bias,
            initial,
            states,
            gates,
            plan,
            options,
        } = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node);
        let values = GruValues {
            inputs: &contiguous(&inputs),
            weight: &contiguous(&weight),
            bias: &contiguous(&bias),
            initial: &contiguous(&initial),
            lengths: options.frames(),
        };
        let saved = (&contiguous(&states)[..], &gates[..]);
        let computed = plan.backward(&values, saved, &contiguous(&gradient));
        let values = [
            (computed.inputs, inputs),
            (computed.weight, weight),
            (computed.bias, bias),
            (computed.initial, initial),
        ];
        for (node, (value, of)) in ops.parents.into_iter().zip(values) {
            if let Some(node) = node {
                let value = tensor(value, of.layout().shape().clone());
                gradients.register::<Flex>(node.id, value);
            }
        }
    }
}

#[derive(Debug)]
struct Gelu;

impl Backward<Flex, 1> for Gelu {
    type State = FlexTensor;

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let gradient = gradients.consume::<Flex>(&ops.node);
        if let [Some(node)] = ops.parents {
            let x = ops.state;
            gradients.register::<Flex>(node.id, of_pairs(&x, &gradient, gelu::backward));
        }
    }
}

#[derive(Debug)]
struct Mapped;

impl Backward<Flex, 1> for Mapped {
    /// The map, and the channels and frames of its input.
    type State = (SharedMap, [usize; 2]);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let gradient = gradients.consume::<Flex>(&ops.node);
        if let [Some(node)] = ops.parents {
            let (map, shape) = ops.state;
            let value = mapped(&gradient, shape, |from, into| map.adjoint(from, into));
            gradients.register::<Flex>(node.id, value);
        }
    }
}

impl<C: CheckpointStrategy> FusedOps for Autodiff<Flex, C> {
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
    ) -> FloatTensor<Self> {
        let nodes = [
            &x,
            &weight,
            &bias,
            &residual,
            &norm_weight,
            &norm_bias,
            &film,
        ]
        .map(|tensor| tensor.node());
        let x = x.into_primitive();
        let weight = weight.into_primitive();
        let rows = HostRows::of(x.clone());
        let norm = plan.norm.map(|plan| {
            let parameters =
                [norm_weight, norm_bias, film, mask].map(|tensor| tensor.into_primitive());
            (
                parameters,
                norm::statistics(rows.view(), &plan, options.frames()),
            )
        });
        let host_norm = norm
            .as_ref()
            .map(|([weight, bias, film, mask], statistics)| {
                (
                    statistics,
                    HostNorm::new([weight, bias, film], mask, &options),
                )
            });
        let output = convolution(
            rows.view(),
            &weight,
            options.bias.then_some(bias.primitive()),
            options.residual.then(|| residual.into_primitive()),
            host_norm
                .as_ref()
                .map(|(statistics, norm)| (*statistics, norm)),
            &plan,
            options.frames(),
        );
        match Convolution.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(
                ConvolutionState {
                    x,
                    weight,
                    norm,
                    plan,
                    options,
                },
                output,
            ),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_group_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        film: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        plan: GroupNormPlan,
        options: Options,
    ) -> FloatTensor<Self> {
        let nodes = [&x, &weight, &bias, &film].map(|tensor| tensor.node());
        let x = x.into_primitive();
        let parameters = [weight, bias, film, mask].map(|tensor| tensor.into_primitive());
        let [weight, bias, film, mask] = &parameters;
        let norm = HostNorm::new([weight, bias, film], mask, &options);
        let rows = HostRows::of(x.clone());
        let statistics = norm::statistics(rows.view(), &plan, options.frames());
        let output = group_norm(rows.view(), &statistics, &norm, &plan);
        match GroupNorm.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(
                NormState {
                    x,
                    parameters,
                    statistics,
                    plan,
                    options,
                },
                output,
            ),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_cross_attention(
        queries: FloatTensor<Self>,
        keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self> {
        let nodes = [queries.node(), keys_values.node()];
        let (queries, keys_values) = (queries.into_primitive(), keys_values.into_primitive());
        let [q, kv] = [&queries, &keys_values].map(FlexTensor::clone);
        let output = Flex::fused_cross_attention(q, kv, num_heads, options.clone());
        match CrossAttention
            .prepare::<C>(nodes)
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                prep.finish((queries, keys_values, num_heads, options), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_self_attention(
        queries_keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self> {
        let nodes = [queries_keys_values.node()];
        let all = queries_keys_values.into_primitive();
        let output = Flex::fused_self_attention(all.clone(), num_heads, options.clone());
        match SelfAttention.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((all, num_heads, options), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn concat_channels(first: FloatTensor<Self>, second: FloatTensor<Self>) -> FloatTensor<Self> {
        let nodes = [first.node(), second.node()];
        let (first, second) = (first.into_primitive(), second.into_primitive());
        let channels = [&first, &second].map(|tensor| tensor.layout().shape()[1]);
        let output = Flex::concat_channels(first, second);
        match Concat.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(channels, output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_gru(
        inputs: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        initial: FloatTensor<Self>,
        plan: GruPlan,
        options: Options,
    ) -> FloatTensor<Self> {
        let nodes = [&inputs, &weight, &bias, &initial].map(|tensor| tensor.node());
        let [inputs, weight, bias, initial] =
            [inputs, weight, bias, initial].map(|tensor| tensor.into_primitive());
        let tensors = [&inputs, &weight, &bias, &initial];
        let (states, gates) = recur(tensors, &plan, &options, true);
        let states = tensor(states, [plan.time, plan.batch, plan.width]);
        match Gru.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(
                GruState {
                    inputs,
                    weight,
                    bias,
                    initial,
                    states: states.clone(),
                    gates,
                    plan,
                    options,
                },
                states,
            ),
            OpsKind::UnTracked(prep) => prep.finish(states),
        }
    }

    fn fused_layer_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        eps: f64,
    ) -> FloatTensor<Self> {
        let nodes = [&x, &weight, &bias].map(|tensor| tensor.node());
        let [x, weight, bias] = [x, weight, bias].map(|tensor| tensor.into_primitive());
        let output = Flex::fused_layer_norm(x.clone(), weight.clone(), bias, eps);
        match LayerNorm.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((x, weight, eps), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self> {
        let nodes = [x.node()];
        let x = x.into_primitive();
        let output = Flex::fused_gelu(x.clone());
        match Gelu.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(x, output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn fused_linear_map(x: FloatTensor<Self>, map: SharedMap) -> FloatTensor<Self> {
        let nodes = [x.node()];
        let x = x.into_primitive();
        let [_, channels, time] = x.layout().shape().dims();
        let output = Flex::fused_linear_map(x, map.clone());
        match Mapped.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((map, [channels, time]), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }
}
