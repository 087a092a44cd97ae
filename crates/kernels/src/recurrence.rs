//! The loop of a gated recurrent unit over time. Callers compute the input projection.

use burn::backend::Dispatch;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Bool, Tensor, TensorData};

use crate::Lengths;
use crate::backend::FusedOps;
use crate::convolution::linear;
use crate::host::recurrence::GruPlan;
use crate::mode::fuses;

/// Direction of a recurrent layer in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the first step to the last.
    Forward,
    /// From the last step to the first.
    Backward,
}

impl Direction {
    /// The steps of a sequence, in order.
    pub(crate) fn steps(self, time: usize) -> Box<dyn DoubleEndedIterator<Item = usize>> {
        match self {
            Self::Forward => Box::new(0..time),
            Self::Backward => Box::new((0..time).rev()),
        }
    }

    /// The last step in this direction.
    pub fn last(self, time: usize) -> usize {
        match self {
            Self::Forward => time - 1,
            Self::Backward => 0,
        }
    }
}

/// The states of a gated recurrent unit after each step:
///
/// ```text
/// r, z = sigmoid(input + state)    n = tanh(input + r * state)    h' = (1 - z) n + z h
/// ```
///
/// `input` is one of the three parts (reset, update, new) of `inputs`, and `state` is the same part
/// of `weight h + bias`. A sequence keeps its state beyond its length. Source: Cho et al. 2014,
/// <https://arxiv.org/abs/1406.1078>, in PyTorch's form.
///
/// # Shapes
/// - inputs: `[time, batch, 3 state]`
/// - weight: `[3 state, state]`, bias: `[3 state]`
/// - initial: `[batch, state]`
/// - lengths: steps of each sequence, all by default
/// - output: `[time, batch, state]`, in the order of `inputs` for both directions
///
/// # Panics
/// Panics if the shapes do not fit, or `time` is 0.
pub fn gru(
    inputs: Tensor<3>,
    weight: Tensor<2>,
    bias: Tensor<1>,
    initial: Tensor<2>,
    lengths: Option<&Lengths>,
    direction: Direction,
) -> Tensor<3> {
    let [time, batch, gates] = inputs.dims();
    let width = gates / 3;
    assert!(time > 0, "a recurrent layer without a step");
    assert_eq!(weight.dims(), [gates, width], "weight of the state");
    assert_eq!(bias.dims(), [gates], "bias of the state");
    assert_eq!(initial.dims(), [batch, width], "initial state");
    if let Some(lengths) = lengths {
        lengths.check(batch, time);
    }
    if !fuses(&inputs) {
        return composed(inputs, weight, bias, initial, lengths, direction);
    }
    let plan = GruPlan {
        time,
        batch,
        width,
        direction,
    };
    Tensor::from_dispatch(Dispatch::fused_gru(
        inputs.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
        initial.into_dispatch(),
        plan,
        lengths.into(),
    ))
}

fn composed(
    inputs: Tensor<3>,
    weight: Tensor<2>,
    bias: Tensor<1>,
    initial: Tensor<2>,
    lengths: Option<&Lengths>,
    direction: Direction,
) -> Tensor<3> {
    let [time, batch, gates] = inputs.dims();
    let width = gates / 3;
    let running = lengths.map(|lengths| running(lengths.frames(), time, &inputs));
    let mut state = initial;
    let mut states = vec![None; time];
    for step in direction.steps(time) {
        let input: Tensor<2> = inputs.clone().narrow(0, step, 1).squeeze_dim(0);
        let recurrent = linear(state.clone(), weight.clone(), bias.clone());
        let part = |of: &Tensor<2>, gate| of.clone().narrow(1, gate * width, width);
        let [reset, update] =
            [0, 1].map(|gate| sigmoid(part(&input, gate) + part(&recurrent, gate)));
        let new = (part(&input, 2) + reset * part(&recurrent, 2)).tanh();
        let next = new.clone() + update * (state.clone() - new);
        state = match &running {
            Some(running) => {
                let runs: Tensor<2, Bool> = running.clone().narrow(0, step, 1).squeeze_dim(0);
                state.mask_where(runs.expand([batch, width]), next)
            }
            None => next,
        };
        states[step] = Some(state.clone());
    }
    Tensor::stack(states.into_iter().flatten().collect(), 0)
}

/// Mask of valid steps: `[time, batch, 1]`.
fn running(lengths: &[usize], time: usize, like: &Tensor<3>) -> Tensor<3, Bool> {
    let has = (0..time).flat_map(|t| lengths.iter().map(move |length| t < *length));
    let has = TensorData::new(has.collect(), [time, lengths.len(), 1]);
    Tensor::from_data(has, &like.device())
}
