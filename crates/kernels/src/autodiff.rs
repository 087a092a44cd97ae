//! Backward passes of the operations.

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind, unary};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Flex};

use crate::backend::{
    FusedOps, MeasuredNorm, Options, attend_backward, convolution, cross_heads, group_norm, mapped,
    norm_gradients, self_heads, with_gru_values, with_input,
};
use crate::flex::{HostRows, contiguous, from_rows, of_pairs, tensor, tensor_like};
use crate::host::convolution::{ConvolutionPlan, Wanted};
use crate::host::gelu;
use crate::host::layer_norm::LayerNormRows;
use crate::host::norm::{self, GroupNormPlan};
use crate::host::recurrence::GruPlan;
use crate::linear_map::SharedMap;

/// The output of an operation with the state of its backward pass.
fn record<C: CheckpointStrategy, B: Backward<Flex, N>, const N: usize>(
    operation: B,
    nodes: [NodeGuard; N],
    state: B::State,
    output: FlexTensor,
) -> FloatTensor<Autodiff<Flex, C>> {
    match operation.prepare::<C>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(state, output),
        OpsKind::UnTracked(prep) => prep.finish(output),
    }
}

/// Registers the gradients of the tracked parents.
fn register<const N: usize>(
    gradients: &mut Gradients,
    parents: [Option<NodeId>; N],
    values: [Option<FlexTensor>; N],
) {
    for (parent, value) in parents.into_iter().zip(values) {
        if let (Some(parent), Some(value)) = (parent, value) {
            gradients.register::<Flex>(parent, value);
        }
    }
}

#[derive(Debug)]
struct Convolution;

impl Backward<Flex, 7> for Convolution {
    /// Input and weight, and the normalization of the input.
    type State = (
        [FlexTensor; 2],
        Option<MeasuredNorm>,
        ConvolutionPlan,
        Options,
    );

    fn backward(self, ops: Ops<Self::State, 7>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let ([x, weight], norm, plan, options) = ops.state;
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let [of_x, of_weight, of_bias, _, of_norm @ ..] = parents.map(|parent| parent.is_some());
        let gradient = gradients.consume::<Flex>(&ops.node);
        let wanted = Wanted {
            input: of_x || (norm.is_some() && of_norm.contains(&true)),
            weight: of_weight,
            bias: options.bias && of_bias,
        };
        let shape = weight.layout().shape().dims::<3>();
        let (x, gradient_rows) = (HostRows::of(x), HostRows::of(gradient.clone()));
        let x = x.view();
        let computed = with_input(x, norm.as_ref(), &options, |input| {
            let weight = contiguous(&weight);
            plan.backward(input, &weight, shape, gradient_rows.view(), wanted)
        });
        let [norm_weight, norm_bias, film] = match computed.norm {
            Some(computed) => norm_gradients(computed, x.batch),
            None => [None, None, None],
        };
        let values = [
            computed.input.map(|values| from_rows(values, x.shape())),
            computed.weight.map(|values| tensor(values, shape)),
            computed.bias.map(|values| {
                let outputs = values.len();
                tensor(values, [outputs])
            }),
            options.residual.then_some(gradient),
            norm_weight,
            norm_bias,
            film,
        ];
        register(gradients, parents, values);
    }
}

#[derive(Debug)]
struct GroupNorm;

impl Backward<Flex, 4> for GroupNorm {
    type State = (FlexTensor, MeasuredNorm, Options);

    fn backward(self, ops: Ops<Self::State, 4>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (x, norm, options) = ops.state;
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let gradient = HostRows::of(gradients.consume::<Flex>(&ops.node));
        let x = HostRows::of(x);
        let x = x.view();
        let mut values: Vec<f32> = gradient.view().to_dense();
        let computed = norm.slices(&options, |norm| norm::backward(x, &norm, &mut values));
        let [weight, bias, film] = norm_gradients(computed, x.batch);
        let values = [Some(from_rows(values, x.shape())), weight, bias, film];
        register(gradients, parents, values);
    }
}

#[derive(Debug)]
struct LayerNorm;

impl Backward<Flex, 3> for LayerNorm {
    /// Rows, scales and eps.
    type State = (FlexTensor, FlexTensor, f64);

    fn backward(self, ops: Ops<Self::State, 3>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (x, weight, eps) = ops.state;
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let gradient = gradients.consume::<Flex>(&ops.node);
        let rows = LayerNormRows {
            x: &contiguous(&x),
            weight: &contiguous(&weight),
            eps,
        };
        let mut like = [&x, &weight, &weight].into_iter();
        let values = rows.backward(&contiguous(&gradient));
        let values = values.map(|values| like.next().map(|like| tensor_like(values, like)));
        register(gradients, parents, values);
    }
}

#[derive(Debug)]
struct CrossAttention;

impl Backward<Flex, 2> for CrossAttention {
    type State = (FlexTensor, FlexTensor, usize, Options);

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (queries, keys_values, num_heads, options) = ops.state;
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let gradient = HostRows::of(gradients.consume::<Flex>(&ops.node));
        let (queries, keys_values) = (HostRows::of(queries), HostRows::of(keys_values));
        let (queries, keys_values) = (queries.view(), keys_values.view());
        let heads = cross_heads(queries, keys_values, num_heads, &options);
        let sizes = [(queries.time, 1), (keys_values.time, 2)];
        let values = attend_backward(heads, gradient.view(), sizes);
        register(gradients, parents, values.map(Some));
    }
}

#[derive(Debug)]
struct SelfAttention;

impl Backward<Flex, 1> for SelfAttention {
    type State = (FlexTensor, usize, Options);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (all, num_heads, options) = ops.state;
        unary::<Flex, _>(ops.parents, ops.node, gradients, |gradient| {
            let (all, gradient) = (HostRows::of(all), HostRows::of(gradient));
            let all = all.view();
            let heads = self_heads(all, num_heads, &options);
            let [value] = attend_backward(heads, gradient.view(), [(all.time, 3)]);
            value
        });
    }
}

#[derive(Debug)]
struct Concat;

impl Backward<Flex, 2> for Concat {
    type State = [usize; 2];

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let gradient = gradients.consume::<Flex>(&ops.node);
        let mut first = 0;
        let values = ops.state.map(|channels| {
            // A view suffices, because the kernels read channels that lie within wider rows.
            let layout = gradient.layout().narrow(1, first, channels);
            first += channels;
            Some(gradient.clone().with_layout(layout))
        });
        register(gradients, parents, values);
    }
}

#[derive(Debug)]
struct Gru;

impl Backward<Flex, 4> for Gru {
    /// Inputs, weight, bias and initial state; the states; the gates.
    type State = ([FlexTensor; 4], FlexTensor, Vec<f32>, GruPlan, Options);

    fn backward(self, ops: Ops<Self::State, 4>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (tensors, states, gates, plan, options) = ops.state;
        let parents = ops.parents.map(|node| node.map(|node| node.id));
        let gradient = gradients.consume::<Flex>(&ops.node);
        let saved = (&contiguous(&states)[..], &gates[..]);
        let values = with_gru_values(&tensors, &options, |values| {
            plan.backward(values, saved, &contiguous(&gradient))
        });
        let mut like = tensors.iter();
        let values = values.map(|values| like.next().map(|like| tensor_like(values, like)));
        register(gradients, parents, values);
    }
}

#[derive(Debug)]
struct Gelu;

impl Backward<Flex, 1> for Gelu {
    type State = FlexTensor;

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        unary::<Flex, _>(ops.parents, ops.node, gradients, |gradient| {
            of_pairs(&ops.state, &gradient, gelu::backward)
        });
    }
}

#[derive(Debug)]
struct Mapped;

impl Backward<Flex, 1> for Mapped {
    /// The map, and the channels and frames of its input.
    type State = (SharedMap, [usize; 2]);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (map, shape) = ops.state;
        unary::<Flex, _>(ops.parents, ops.node, gradients, |gradient| {
            mapped(&gradient, shape, |from, into| map.adjoint(from, into))
        });
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
        let inputs = [x, weight, bias, residual, norm_weight, norm_bias, film];
        let nodes = inputs.each_ref().map(|tensor| tensor.node());
        let [x, weight, bias, residual, norm_weight, norm_bias, film] =
            inputs.map(|tensor| tensor.into_primitive());
        let rows = HostRows::of(x.clone());
        let norm = [norm_weight, norm_bias, film, mask.into_primitive()];
        let norm = plan
            .norm
            .map(|plan| MeasuredNorm::new(rows.view(), plan, norm, &options));
        let output = convolution(
            rows.view(),
            &weight,
            &bias,
            residual,
            norm.as_ref(),
            &plan,
            &options,
        );
        record::<C, _, 7>(
            Convolution,
            nodes,
            ([x, weight], norm, plan, options),
            output,
        )
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
        let tensors = [weight, bias, film, mask].map(|tensor| tensor.into_primitive());
        let rows = HostRows::of(x.clone());
        let norm = MeasuredNorm::new(rows.view(), plan, tensors, &options);
        let output = group_norm(rows.view(), &norm, &options);
        record::<C, _, 4>(GroupNorm, nodes, (x, norm, options), output)
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
        let state = (queries, keys_values, num_heads, options);
        record::<C, _, 2>(CrossAttention, nodes, state, output)
    }

    fn fused_self_attention(
        queries_keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self> {
        let (all, node) = queries_keys_values.into_parts();
        let output = Flex::fused_self_attention(all.clone(), num_heads, options.clone());
        record::<C, _, 1>(SelfAttention, [node], (all, num_heads, options), output)
    }

    fn concat_channels(first: FloatTensor<Self>, second: FloatTensor<Self>) -> FloatTensor<Self> {
        let nodes = [first.node(), second.node()];
        let (first, second) = (first.into_primitive(), second.into_primitive());
        let channels = [&first, &second].map(|tensor| tensor.layout().shape()[1]);
        let output = Flex::concat_channels(first, second);
        record::<C, _, 2>(Concat, nodes, channels, output)
    }

    fn fused_gru(
        inputs: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        initial: FloatTensor<Self>,
        plan: GruPlan,
        options: Options,
    ) -> FloatTensor<Self> {
        let tensors = [inputs, weight, bias, initial];
        let nodes = tensors.each_ref().map(|tensor| tensor.node());
        let tensors = tensors.map(|tensor| tensor.into_primitive());
        let (states, gates) =
            with_gru_values(&tensors, &options, |values| plan.forward(values, true));
        let states = tensor(states, [plan.time, plan.batch, plan.width]);
        let state = (tensors, states.clone(), gates, plan, options);
        record::<C, _, 4>(Gru, nodes, state, states)
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
        record::<C, _, 3>(LayerNorm, nodes, (x, weight, eps), output)
    }

    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self> {
        let (x, node) = x.into_parts();
        let output = Flex::fused_gelu(x.clone());
        record::<C, _, 1>(Gelu, [node], x, output)
    }

    fn fused_linear_map(x: FloatTensor<Self>, map: SharedMap) -> FloatTensor<Self> {
        let (x, node) = x.into_parts();
        let [_, channels, time] = x.layout().shape().dims();
        let output = Flex::fused_linear_map(x, map.clone());
        record::<C, _, 1>(Mapped, [node], (map, [channels, time]), output)
    }
}
