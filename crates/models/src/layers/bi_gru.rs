use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::{Direction, Lengths, gru, linear};

use crate::Initializer;

/// A gated recurrent unit ([`gru`]) with `inputs = weight_ih x + bias_ih`, in both directions or
/// only forward ([`forwards`](Self::forwards)).
///
/// Names and layouts are torch's for a bidirectional `GRU` of one layer: weights `[3 state, in]`
/// and `[3 state, state]`, biases `[3 state]`.
#[derive(Module, Debug)]
pub struct BiGru {
    weight_ih_l0: Param<Tensor<2>>,
    weight_hh_l0: Param<Tensor<2>>,
    bias_ih_l0: Param<Tensor<1>>,
    bias_hh_l0: Param<Tensor<1>>,
    weight_ih_l0_reverse: Option<Param<Tensor<2>>>,
    weight_hh_l0_reverse: Option<Param<Tensor<2>>>,
    bias_ih_l0_reverse: Option<Param<Tensor<1>>>,
    bias_hh_l0_reverse: Option<Param<Tensor<1>>>,
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
            weight_ih_l0_reverse: Some(weight("weight_ih_l0_reverse", inputs)),
            weight_hh_l0_reverse: Some(weight("weight_hh_l0_reverse", state)),
            bias_ih_l0_reverse: Some(bias("bias_ih_l0_reverse")),
            bias_hh_l0_reverse: Some(bias("bias_hh_l0_reverse")),
        }
    }

    /// The layer without its backward direction.
    #[must_use]
    pub fn forwards(self) -> Self {
        Self {
            weight_ih_l0_reverse: None,
            weight_hh_l0_reverse: None,
            bias_ih_l0_reverse: None,
            bias_hh_l0_reverse: None,
            ..self
        }
    }

    /// The states over the first `lengths[i]` steps of sequence i. The backward direction begins at
    /// the last of these steps.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`, `lengths` from 1 to `time`
    /// - initial: `[2, 1, state]`, the initial state of each direction
    pub fn forward(&self, x: Tensor<3>, lengths: &[usize], initial: Tensor<3>) -> GruStates {
        let [batch, inputs, time] = x.dims();
        let rows = x.permute([2, 0, 1]).reshape([time * batch, inputs]);
        let some_end_before = lengths.iter().any(|&length| length < time);
        let lengths = some_end_before.then(|| Lengths::new(lengths.iter().copied()));
        let states = |index,
                      direction,
                      [weight_ih, weight_hh]: [&Param<Tensor<2>>; 2],
                      bias: [&Param<Tensor<1>>; 2]| {
            let [bias_ih, bias_hh] = bias;
            let inputs = linear(rows.clone(), weight_ih.val(), bias_ih.val());
            let [_, gates] = inputs.dims();
            let begin = initial.clone().narrow(0, index, 1).squeeze_dim::<2>(0);
            gru(
                inputs.reshape([time, batch, gates]),
                weight_hh.val(),
                bias_hh.val(),
                begin.expand([batch, gates / 3]),
                lengths.as_ref(),
                direction,
            )
        };
        let forward = states(
            0,
            Direction::Forward,
            [&self.weight_ih_l0, &self.weight_hh_l0],
            [&self.bias_ih_l0, &self.bias_hh_l0],
        );
        let reverse = self
            .weight_ih_l0_reverse
            .as_ref()
            .zip(self.weight_hh_l0_reverse.as_ref());
        let biases = self
            .bias_ih_l0_reverse
            .as_ref()
            .zip(self.bias_hh_l0_reverse.as_ref());
        let backward = reverse
            .zip(biases)
            .map(|(weights, biases)| states(1, Direction::Backward, weights.into(), biases.into()));
        let last = |states: &Tensor<3>, direction: Direction| {
            let step = states.clone().narrow(0, direction.last(time), 1);
            step.squeeze_dim::<2>(0)
        };
        let mut ends = vec![last(&forward, Direction::Forward)];
        ends.extend(
            backward
                .as_ref()
                .map(|states| last(states, Direction::Backward)),
        );
        GruStates {
            last: Tensor::cat(ends, 1),
            forward,
            backward,
        }
    }
}

/// The output of a [`BiGru`].
#[derive(Clone, Debug)]
pub struct GruStates {
    /// The state after each step forward: `[time, batch, state]`.
    pub forward: Tensor<3>,
    /// The state after each step backward, if the layer has a backward direction: `[time, batch,
    /// state]`.
    pub backward: Option<Tensor<3>>,
    /// The final states of each sequence, forward then backward: `[batch, 2 state]`, or `[batch,
    /// state]` without a backward direction.
    pub last: Tensor<2>,
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn padding_has_no_influence() {
        let device = Device::flex();
        let gru = BiGru::new(3, 4, &Initializer::new(1, &device));
        let values = |shape: [usize; 3]| {
            let values = (0..shape.iter().product()).map(|i: usize| (i as f32 * 0.7).sin());
            Tensor::<3>::from_data(TensorData::new(values.collect(), shape), &device)
        };
        let (x, initial) = (values([3, 3, 6]), values([2, 1, 4]));
        let lengths = [6, 1, 4];
        let together = gru.forward(x.clone(), &lengths, initial.clone()).last;
        assert_eq!(together.dims(), [3, 8]);
        for (item, length) in lengths.into_iter().enumerate() {
            let alone = x.clone().narrow(0, item, 1).narrow(2, 0, length);
            let alone = gru.forward(alone, &[length], initial.clone()).last;
            let apart = (alone - together.clone().narrow(0, item, 1)).abs().max();
            assert!(apart.into_scalar::<f32>() < 1e-6, "sequence {item}");
        }
    }
}
