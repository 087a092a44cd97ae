//! The layers of the encoders, for inference. A column of a matrix is a step or a sample.

use nalgebra::{DMatrix, DVector, Dyn, Matrix, Storage};

use super::weights::NamedArrays;

/// The slope of every leaky rectifier for negative numbers.
const SLOPE: f32 = 0.2;

/// What a layer norm adds to the variance (PyTorch's default).
const NORM_EPSILON: f64 = 1e-5;

/// Length and step of a convolution's windows, and the zeros in front of the first frame.
const KERNEL: usize = 4;
const STRIDE: usize = 2;
const PADDING: usize = 1;

/// The values of an array that [`check`](super::weights::check) has accepted.
fn values<'a>(arrays: &'a NamedArrays, layer: &str, name: &str) -> &'a [f32] {
    &arrays[&format!("{layer}{name}")].1
}

/// A linear layer: weight `[out, in]` and bias `[out]`.
#[derive(Clone, Debug)]
pub(super) struct Linear {
    weight: DMatrix<f32>,
    bias: DVector<f32>,
}

impl Linear {
    /// The layer `name`, with `name.weight` and `name.bias`.
    pub fn read(arrays: &NamedArrays, name: &str) -> Self {
        Self::of(
            values(arrays, name, ".weight"),
            values(arrays, name, ".bias"),
        )
    }

    /// A layer of row-major values.
    fn of(weight: &[f32], bias: &[f32]) -> Self {
        let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
        Self {
            weight: DMatrix::from_row_slice(outputs, inputs, weight),
            bias: DVector::from_column_slice(bias),
        }
    }

    pub fn inputs(&self) -> usize {
        self.weight.ncols()
    }

    pub fn outputs(&self) -> usize {
        self.weight.nrows()
    }

    /// `[in, n]` to `[out, n]`.
    pub fn apply<S>(&self, input: &Matrix<f32, Dyn, Dyn, S>) -> DMatrix<f32>
    where
        S: Storage<f32, Dyn, Dyn>,
    {
        let mut output = &self.weight * input;
        for mut column in output.column_iter_mut() {
            column += &self.bias;
        }
        output
    }
}

/// A convolution along time with windows of four frames, two frames apart.
#[derive(Clone, Debug)]
pub(super) struct Convolution {
    /// Of the windows, `[out, in * 4]`.
    linear: Linear,
}

impl Convolution {
    /// The layer `name`, weight `[out, in, 4]`.
    pub fn read(arrays: &NamedArrays, name: &str) -> Self {
        let linear = Linear::read(arrays, name);
        Self { linear }
    }

    pub fn inputs(&self) -> usize {
        self.linear.inputs() / KERNEL
    }

    /// How many windows `frames` frames and the zeros on both sides have.
    pub fn steps(frames: usize) -> usize {
        (frames + 2 * PADDING).saturating_sub(KERNEL - STRIDE) / STRIDE
    }

    /// The first `steps` windows of frames `[in, n]`, zeros behind them: `[out, steps]`.
    pub fn apply(&self, frames: &DMatrix<f32>, steps: usize) -> DMatrix<f32> {
        let windows = DMatrix::from_fn(self.linear.inputs(), steps, |row, step| {
            let (channel, place) = (row / KERNEL, row % KERNEL);
            let frame = (step * STRIDE + place).checked_sub(PADDING);
            let frame = frame.filter(|frame| *frame < frames.ncols());
            frame.map_or(0.0, |frame| frames[(channel, frame)])
        });
        self.linear.apply(&windows)
    }
}

/// Normalisation of each column to mean 0 and variance 1, then scale and shift by row.
#[derive(Clone, Debug)]
pub(super) struct LayerNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl LayerNorm {
    /// The layer `name`.
    pub fn read(arrays: &NamedArrays, name: &str) -> Self {
        Self {
            weight: values(arrays, name, ".weight").to_vec(),
            bias: values(arrays, name, ".bias").to_vec(),
        }
    }

    pub fn apply(&self, input: &mut DMatrix<f32>) {
        let rows = input.nrows() as f64;
        for mut column in input.column_iter_mut() {
            let mean = column.iter().map(|&value| f64::from(value)).sum::<f64>() / rows;
            let square = |&value: &f32| (f64::from(value) - mean).powi(2);
            let variance = column.iter().map(square).sum::<f64>() / rows;
            let scale = (variance + NORM_EPSILON).sqrt().recip();
            let shifts = self.weight.iter().zip(&self.bias);
            for (value, (weight, bias)) in column.iter_mut().zip(shifts) {
                *value = ((f64::from(*value) - mean) * scale) as f32 * weight + bias;
            }
        }
    }
}

/// The leaky rectifier.
pub(super) fn leaky_relu(values: &mut DMatrix<f32>) {
    values.apply(|value| *value = value.max(SLOPE * *value));
}

fn sigmoid(value: f32) -> f32 {
    (1.0 + (-value).exp()).recip()
}

/// A gated recurrent unit that runs over sequences in one direction; the last state is all that is
/// asked of it.
///
/// ```text
/// r, z = sigmoid(input + state)    n = tanh(input + r * state)    h' = (1 - z) n + z h
/// ```
///
/// with `input` and `state` the three parts of `weight_ih x + bias_ih` and `weight_hh h + bias_hh`.
/// Source: Cho et al. 2014, <https://arxiv.org/abs/1406.1078>, in PyTorch's form.
#[derive(Clone, Debug)]
pub(super) struct Recurrence {
    input: Linear,
    state: Linear,
    initial: DVector<f32>,
    backward: bool,
}

impl Recurrence {
    /// One direction of the layer `gru`, and its row of `hidden`.
    pub fn read(arrays: &NamedArrays, backward: bool) -> Self {
        let suffix = if backward { "_reverse" } else { "" };
        let layer = |part: &str| {
            let name = |kind: &str| format!("gru.{kind}_{part}_l0{suffix}");
            Linear::of(
                values(arrays, &name("weight"), ""),
                values(arrays, &name("bias"), ""),
            )
        };
        let state = layer("hh");
        let initial = values(arrays, "hidden", "").chunks_exact(state.inputs());
        let initial = initial.skip(usize::from(backward)).flatten().copied();
        Self {
            input: layer("ih"),
            initial: DVector::from_iterator(state.inputs(), initial.take(state.inputs())),
            state,
            backward,
        }
    }

    /// The state after the last step of each sequence `[in, steps]`, in the direction of the
    /// recurrence: `[state, sequences]`. The sequences must come longest first.
    pub fn last_states(&self, sequences: &[DMatrix<f32>]) -> DMatrix<f32> {
        let inputs: Vec<_> = sequences.iter().map(|s| self.input.apply(s)).collect();
        let width = self.initial.len();
        let mut states = DMatrix::from_fn(width, inputs.len(), |row, _| self.initial[row]);
        for step in 0..inputs.first().map_or(0, DMatrix::ncols) {
            let running = inputs.partition_point(|input| input.ncols() > step);
            let recurrent = self.state.apply(&states.columns(0, running));
            for (column, input) in inputs[..running].iter().enumerate() {
                let place = match self.backward {
                    true => input.ncols() - 1 - step,
                    false => step,
                };
                let (input, recurrent) = (input.column(place), recurrent.column(column));
                let mut state = states.column_mut(column);
                for i in 0..width {
                    let reset = sigmoid(input[i] + recurrent[i]);
                    let update = sigmoid(input[width + i] + recurrent[width + i]);
                    let new = (input[2 * width + i] + reset * recurrent[2 * width + i]).tanh();
                    state[i] = (1.0 - update) * new + update * state[i];
                }
            }
        }
        states
    }
}
