use burn::module::{Module, Param};
use burn::tensor::activation::sigmoid;
use burn::tensor::{Bool, Tensor, TensorData};
use kinegrad_kernels::linear;

use crate::Initializer;

/// A gated recurrent unit that runs over sequences in both directions; the last states are all that
/// is asked of it.
///
/// ```text
/// r, z = sigmoid(input + state)    n = tanh(input + r * state)    h' = (1 - z) n + z h
/// ```
///
/// with `input` and `state` the three parts (reset, update, new) of `weight_ih x + bias_ih` and
/// `weight_hh h + bias_hh`. Names and layouts are those of torch's bidirectional `GRU` of one
/// layer: weights `[3 state, in]` and `[3 state, state]`, biases `[3 state]`. Source: Cho et al.
/// 2014, <https://arxiv.org/abs/1406.1078>, in PyTorch's form.
#[derive(Module, Debug)]
pub struct BiGru {
    weight_ih_l0: Param<Tensor<2>>,
    weight_hh_l0: Param<Tensor<2>>,
    bias_ih_l0: Param<Tensor<1>>,
    bias_hh_l0: Param<Tensor<1>>,
    weight_ih_l0_reverse: Param<Tensor<2>>,
    weight_hh_l0_reverse: Param<Tensor<2>>,
    bias_ih_l0_reverse: Param<Tensor<1>>,
    bias_hh_l0_reverse: Param<Tensor<1>>,
}

impl BiGru {
    /// A layer from `inputs` to `state` features in each direction.
    pub fn new(inputs: usize, state: usize, init: &Initializer) -> Self {
        let weight = |name, inputs| init.uniform(name, [3 * state, inputs], state);
        let bias = |name| init.uniform(name, [3 * state], state);
        Self {
            weight_ih_l0: weight("weight_ih_l0", inputs),
            weight_hh_l0: weight("weight_hh_l0", state),
            bias_ih_l0: bias("bias_ih_l0"),
            bias_hh_l0: bias("bias_hh_l0"),
            weight_ih_l0_reverse: weight("weight_ih_l0_reverse", inputs),
            weight_hh_l0_reverse: weight("weight_hh_l0_reverse", state),
            bias_ih_l0_reverse: bias("bias_ih_l0_reverse"),
            bias_hh_l0_reverse: bias("bias_hh_l0_reverse"),
        }
    }

    /// The state after the last step of each sequence forward, then after its first step backward.
    /// A sequence is its first `lengths[i]` steps: what follows them is not seen, and the backward
    /// direction begins at the last of them.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`, `lengths` at most `time`
    /// - initial: `[2, 1, state]`, where each direction begins
    /// - output: `[batch, 2 state]`
    pub fn last_states(&self, x: Tensor<3>, lengths: &[usize], initial: Tensor<3>) -> Tensor<2> {
        let [batch, inputs, time] = x.dims();
        let running = (0..time).flat_map(|t| lengths.iter().map(move |length| t < *length));
        let running = TensorData::new(running.collect(), [time, batch, 1]);
        let running = Tensor::from_data(running, &x.device());
        let rows = x.permute([2, 0, 1]).reshape([time * batch, inputs]);
        let begin = |direction| initial.clone().narrow(0, direction, 1).squeeze_dim(0);
        let forward = last_state(
            linear(rows.clone(), self.weight_ih_l0.val(), self.bias_ih_l0.val()),
            (self.weight_hh_l0.val(), self.bias_hh_l0.val()),
            begin(0),
            &running,
            0..time,
        );
        let backward = last_state(
            linear(
                rows,
                self.weight_ih_l0_reverse.val(),
                self.bias_ih_l0_reverse.val(),
            ),
            (
                self.weight_hh_l0_reverse.val(),
                self.bias_hh_l0_reverse.val(),
            ),
            begin(1),
            &running,
            (0..time).rev(),
        );
        Tensor::cat(vec![forward, backward], 1)
    }
}

/// Runs through `steps`; a sequence keeps its state in those that it does not have.
///
/// # Shapes
/// - inputs: `[time * batch, 3 state]`, the inputs' part of the gates
/// - weight: `[3 state, state]`, bias: `[3 state]`
/// - initial: `[1, state]`
/// - running: `[time, batch, 1]`
/// - output: `[batch, state]`
fn last_state(
    inputs: Tensor<2>,
    (weight, bias): (Tensor<2>, Tensor<1>),
    initial: Tensor<2>,
    running: &Tensor<3, Bool>,
    steps: impl Iterator<Item = usize>,
) -> Tensor<2> {
    let (batch, width) = (running.dims()[1], initial.dims()[1]);
    let mut state = initial.expand([batch, width]);
    for step in steps {
        let input = inputs.clone().narrow(0, step * batch, batch);
        let recurrent = linear(state.clone(), weight.clone(), bias.clone());
        let part = |of: &Tensor<2>, gate| of.clone().narrow(1, gate * width, width);
        let [reset, update] =
            [0, 1].map(|gate| sigmoid(part(&input, gate) + part(&recurrent, gate)));
        let new = (part(&input, 2) + reset * part(&recurrent, 2)).tanh();
        let next = new.clone() + update * (state.clone() - new);
        let runs = running.clone().narrow(0, step, 1).squeeze_dim::<2>(0);
        state = state.mask_where(runs.expand([batch, width]), next);
    }
    state
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn what_follows_a_sequence_is_not_seen() {
        let device = Device::flex();
        let gru = BiGru::new(3, 4, &Initializer::new(1, &device));
        let draw = |shape: [usize; 3]| {
            let values = (0..shape.iter().product()).map(|i: usize| (i as f32 * 0.7).sin());
            Tensor::<3>::from_data(TensorData::new(values.collect(), shape), &device)
        };
        let (x, initial) = (draw([3, 3, 6]), draw([2, 1, 4]));
        let lengths = [6, 1, 4];
        let together = gru.last_states(x.clone(), &lengths, initial.clone());
        assert_eq!(together.dims(), [3, 8]);
        for (item, length) in lengths.into_iter().enumerate() {
            let alone = x.clone().narrow(0, item, 1).narrow(2, 0, length);
            let alone = gru.last_states(alone, &[length], initial.clone());
            let apart = (alone - together.clone().narrow(0, item, 1)).abs().max();
            assert!(apart.into_scalar::<f32>() < 1e-6, "sequence {item}");
        }
    }
}
