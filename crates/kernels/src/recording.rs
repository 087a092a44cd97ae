//! Recording of operations for the backward pass, with or without activation checkpointing.
//!
//! With activation checkpointing an output that is cheap to compute is not stored: the operations
//! after it store the node, and the backward pass computes the output again, with equal bits.

use std::any::TypeId;
use std::fmt;
use std::marker::PhantomData;

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::retro_forward::RetroForward;
use burn::backend::autodiff::checkpoint::state::BackwardStates;
use burn::backend::autodiff::checkpoint::strategy::{CheckpointStrategy, NoCheckpointing};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Dispatch, Flex};
use burn::tensor::Tensor;

use crate::backend::FusedOps;
use crate::mode::fuses;

/// `x`, which activation checkpointing stores, with the kernels: without it, a sum at the end of each
/// block would be computed again from that of the block before it, and so on to the first.
pub fn stored(x: Tensor<3>) -> Tensor<3> {
    match fuses(&x) {
        true => Tensor::from_dispatch(Dispatch::stored(x.into_dispatch())),
        false => x,
    }
}

type Tracked<C> = FloatTensor<Autodiff<Flex, C>>;

/// A tensor of the forward pass: itself, or the node that computes it.
#[derive(Clone, Debug)]
pub(crate) enum Saved {
    Tensor(FlexTensor),
    Node(NodeId),
}

impl Saved {
    /// The tensor, in a backward pass.
    pub fn tensor(self, checkpointer: &mut Checkpointer) -> FlexTensor {
        match self {
            Self::Tensor(tensor) => tensor,
            Self::Node(id) => checkpointer.retrieve_node_output(id),
        }
    }
}

/// True for the strategies of activation checkpointing.
pub(crate) fn checkpoints<C: CheckpointStrategy>() -> bool {
    TypeId::of::<C>() != TypeId::of::<NoCheckpointing>()
}

/// The inputs of an operation that is recorded.
pub(crate) struct Inputs<C: CheckpointStrategy, const N: usize> {
    nodes: [NodeGuard; N],
    /// With activation checkpointing.
    tensors: Option<[Tracked<C>; N]>,
    strategy: PhantomData<C>,
}

impl<C: CheckpointStrategy, const N: usize> Inputs<C, N> {
    pub fn of(tensors: &[Tracked<C>; N]) -> Self {
        Self {
            nodes: tensors.each_ref().map(|tensor| tensor.node()),
            tensors: checkpoints::<C>().then(|| tensors.clone()),
            strategy: PhantomData,
        }
    }

    /// The output of an operation. `state` gives the state of its backward pass; it calls its
    /// argument with the index of an input and the input, to save it. `recompute` computes the
    /// output from the inputs again, for an output that activation checkpointing does not store.
    pub fn record<B, F>(
        self,
        operation: B,
        recompute: Option<F>,
        state: impl FnOnce(&mut dyn FnMut(usize, FlexTensor) -> Saved) -> B::State,
        output: FlexTensor,
    ) -> Tracked<C>
    where
        B: Backward<Flex, N>,
        F: Fn([FlexTensor; N]) -> FlexTensor + Send + 'static,
    {
        let Self { nodes, tensors, .. } = self;
        let prep = operation.prepare::<C>(nodes);
        let prep = match (&tensors, recompute) {
            (Some(inputs), Some(recompute)) => {
                let retro = Recomputation {
                    inputs: inputs.each_ref().map(|input| match is_tracked::<C>(input) {
                        true => Saved::Node(input.id()),
                        false => Saved::Tensor(input.primitive().clone()),
                    }),
                    recompute,
                };
                let tracked = inputs.iter().filter(|input| is_tracked::<C>(input));
                prep.memory_bound().retro_forward(retro).parents(tracked)
            }
            _ => prep.compute_bound(),
        };
        match prep.stateful() {
            OpsKind::Tracked(mut prep) => {
                let state = state(&mut |index, tensor| match &tensors {
                    Some(inputs) if is_tracked::<C>(&inputs[index]) => {
                        Saved::Node(prep.checkpoint(&inputs[index]))
                    }
                    _ => Saved::Tensor(tensor),
                });
                prep.finish(state, output)
            }
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }
}

/// The computation of an output in the backward pass.
struct Recomputation<F, const N: usize> {
    inputs: [Saved; N],
    recompute: F,
}

impl<F, const N: usize> fmt::Debug for Recomputation<F, N> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = formatter.debug_struct("Recomputation");
        shown.field("inputs", &self.inputs).finish_non_exhaustive()
    }
}

impl<F, const N: usize> RetroForward for Recomputation<F, N>
where
    F: Fn([FlexTensor; N]) -> FlexTensor + Send + 'static,
{
    fn forward(&self, states: &mut BackwardStates, out_node: NodeId) {
        let inputs = self.inputs.each_ref().map(|input| match input {
            Saved::Tensor(tensor) => tensor.clone(),
            Saved::Node(id) => states.get_state::<FlexTensor>(id),
        });
        states.save(out_node, (self.recompute)(inputs));
    }
}

/// True if gradients flow to the tensor, which Burn tells an operation in preparation alone.
fn is_tracked<C: CheckpointStrategy>(tensor: &Tracked<C>) -> bool {
    #[derive(Debug)]
    struct Probe;
    impl Backward<Flex, 1> for Probe {
        type State = ();
        fn backward(self, _: Ops<(), 1>, _: &mut Gradients, _: &mut Checkpointer) {}
    }
    let prep = Probe.prepare::<C>([tensor.node()]);
    matches!(prep.compute_bound().stateful(), OpsKind::Tracked(_))
}
