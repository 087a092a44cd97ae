//! Backward passes of the operations.

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, unary};
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
use crate::recording::{Inputs, Saved, checkpoints};

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
        Saved,
        FlexTensor,
        Option<MeasuredNorm>,
        ConvolutionPlan,
        Options,
    );

    fn backward(
        self,
        ops: Ops<Self::State, 7>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let (x, weight, norm, plan, options) = ops.state;
        let x = x.tensor(checkpointer);
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
    type State = (Saved, MeasuredNorm, Options);

    fn backward(
        self,
        ops: Ops<Self::State, 4>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let (x, norm, options) = ops.state;
        let x = x.tensor(checkpointer);
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
    type State = (Saved, FlexTensor, f64);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let (x, weight, eps) = ops.state;
        let x = x.tensor(checkpointer);
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
    type State = ([Saved; 2], usize, Options);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let (saved, num_heads, options) = ops.state;
        let [queries, keys_values] = saved.map(|saved| saved.tensor(checkpointer));
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
    type State = (Saved, usize, Options);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let (all, num_heads, options) = ops.state;
        let all = all.tensor(checkpointer);
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
    type State = Saved;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let x = ops.state.tensor(checkpointer);
        unary::<Flex, _>(ops.parents, ops.node, gradients, |gradient| {
            of_pairs(&x, &gradient, gelu::backward)
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

#[derive(Debug)]
struct Identity;

impl Backward<Flex, 1> for Identity {
    type State = ();

    fn backward(self, ops: Ops<(), 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        unary::<Flex, _>(ops.parents, ops.node, gradients, |gradient| gradient);
    }
}

/// For an operation whose output is stored.
type Stored<const N: usize> = fn([FlexTensor; N]) -> FlexTensor;

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
        let recorded = Inputs::<C, 7>::of(&inputs);
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
        let recompute = options.recomputed.then(|| {
            let (norm, options) = (norm.clone(), options.clone());
            move |[x, weight, bias, residual, ..]: [FlexTensor; 7]| {
                let x = HostRows::of(x);
                let norm = norm.as_ref();
                convolution(x.view(), &weight, &bias, residual, norm, &plan, &options)
            }
        });
        let state = |save: &mut dyn FnMut(_, _) -> _| (save(0, x), weight, norm, plan, options);
        recorded.record(Convolution, recompute, state, output)
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
        let inputs = [x, weight, bias, film];
        let recorded = Inputs::<C, 4>::of(&inputs);
        let [x, weight, bias, film] = inputs.map(|tensor| tensor.into_primitive());
        let rows = HostRows::of(x.clone());
        let tensors = [weight, bias, film, mask.into_primitive()];
        let norm = MeasuredNorm::new(rows.view(), plan, tensors, &options);
        let output = group_norm(rows.view(), &norm, &options);
        let recompute = {
            let (norm, options) = (norm.clone(), options.clone());
            move |[x, ..]: [FlexTensor; 4]| group_norm(HostRows::of(x).view(), &norm, &options)
        };
        let state = |save: &mut dyn FnMut(_, _) -> _| (save(0, x), norm, options);
        recorded.record(GroupNorm, Some(recompute), state, output)
    }

    fn fused_cross_attention(
        queries: FloatTensor<Self>,
        keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self> {
        let inputs = [queries, keys_values];
        let recorded = Inputs::<C, 2>::of(&inputs);
        let [queries, keys_values] = inputs.map(|tensor| tensor.into_primitive());
        let attend = {
            let options = options.clone();
            move |[queries, keys_values]: [FlexTensor; 2]| {
                Flex::fused_cross_attention(queries, keys_values, num_heads, options.clone())
            }
        };
        let output = attend([queries.clone(), keys_values.clone()]);
        let state = |save: &mut dyn FnMut(_, _) -> _| {
            ([save(0, queries), save(1, keys_values)], num_heads, options)
        };
        recorded.record(CrossAttention, Some(attend), state, output)
    }

    fn fused_self_attention(
        queries_keys_values: FloatTensor<Self>,
        num_heads: usize,
        options: Options,
    ) -> FloatTensor<Self> {
        let inputs = [queries_keys_values];
        let recorded = Inputs::<C, 1>::of(&inputs);
        let [all] = inputs.map(|tensor| tensor.into_primitive());
        let attend = {
            let options = options.clone();
            move |[all]: [FlexTensor; 1]| {
                Flex::fused_self_attention(all, num_heads, options.clone())
            }
        };
        let output = attend([all.clone()]);
        let state = |save: &mut dyn FnMut(_, _) -> _| (save(0, all), num_heads, options);
        recorded.record(SelfAttention, Some(attend), state, output)
    }

    fn concat_channels(first: FloatTensor<Self>, second: FloatTensor<Self>) -> FloatTensor<Self> {
        let inputs = [first, second];
        let recorded = Inputs::<C, 2>::of(&inputs);
        let parts = inputs.map(|tensor| tensor.into_primitive());
        let channels = parts.each_ref().map(|part| part.layout().shape()[1]);
        let concat = |[first, second]: [FlexTensor; 2]| Flex::concat_channels(first, second);
        recorded.record(Concat, Some(concat), |_| channels, concat(parts))
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
        let recorded = Inputs::<C, 4>::of(&tensors);
        let tensors = tensors.map(|tensor| tensor.into_primitive());
        let (states, gates) =
            with_gru_values(&tensors, &options, |values| plan.forward(values, true));
        let states = tensor(states, [plan.time, plan.batch, plan.width]);
        let state = (tensors, states.clone(), gates, plan, options);
        recorded.record(Gru, None::<Stored<4>>, |_| state, states)
    }

    fn fused_layer_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        eps: f64,
    ) -> FloatTensor<Self> {
        let inputs = [x, weight, bias];
        let recorded = Inputs::<C, 3>::of(&inputs);
        let [x, weight, bias] = inputs.map(|tensor| tensor.into_primitive());
        let norm =
            move |[x, weight, bias]: [FlexTensor; 3]| Flex::fused_layer_norm(x, weight, bias, eps);
        let output = norm([x.clone(), weight.clone(), bias]);
        let state = |save: &mut dyn FnMut(_, _) -> _| (save(0, x), weight, eps);
        recorded.record(LayerNorm, Some(norm), state, output)
    }

    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self> {
        let inputs = [x];
        let recorded = Inputs::<C, 1>::of(&inputs);
        let [x] = inputs.map(|tensor| tensor.into_primitive());
        let activate = |[x]: [FlexTensor; 1]| Flex::fused_gelu(x);
        let output = activate([x.clone()]);
        let state = |save: &mut dyn FnMut(_, _) -> _| save(0, x);
        recorded.record(Gelu, Some(activate), state, output)
    }

    fn fused_linear_map(x: FloatTensor<Self>, map: SharedMap) -> FloatTensor<Self> {
        let inputs = [x];
        let recorded = Inputs::<C, 1>::of(&inputs);
        let [x] = inputs.map(|tensor| tensor.into_primitive());
        let [_, channels, time] = x.layout().shape().dims();
        let apply = {
            let map = map.clone();
            move |[x]: [FlexTensor; 1]| Flex::fused_linear_map(x, map.clone())
        };
        let output = apply([x]);
        let state = (map, [channels, time]);
        recorded.record(Mapped, Some(apply), |_| state, output)
    }

    fn stored(x: FloatTensor<Self>) -> FloatTensor<Self> {
        if !checkpoints::<C>() {
            return x;
        }
        let inputs = [x];
        let recorded = Inputs::<C, 1>::of(&inputs);
        let [x] = inputs.map(|tensor| tensor.into_primitive());
        recorded.record(Identity, None::<Stored<1>>, |_| (), x)
    }
}
