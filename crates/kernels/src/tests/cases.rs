//! Operations with random tensors, run in either mode.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::{
    Activation, Convolution, GroupNorm, KeyRanges, Lengths, concat_channels, cross_attention, gelu,
    host_values, layer_norm, ranged_attention, self_attention,
};
use crate::{Mode, linear};

/// The memory layout of an operation's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Memory {
    /// `[batch, channels, time]` without gaps.
    Contiguous,
    /// `[batch, time, channels]` without gaps.
    ChannelsLast,
    /// Some channels of a wider tensor.
    Part,
    /// Time runs backwards.
    Flipped,
}

/// One operation and its sizes.
#[derive(Clone, Debug)]
pub enum Operation {
    Convolution {
        kernel: usize,
        stride: usize,
        transposed: bool,
        /// `Some(true)` keeps twice the frames, `Some(false)` one frame less.
        upsample: Option<bool>,
        norm: Option<Norm>,
        residual: bool,
        bias: bool,
    },
    GroupNorm(Norm),
    CrossAttention {
        num_heads: usize,
        keys: usize,
        /// Largest distance of a query's keys.
        reach: Option<usize>,
    },
    SelfAttention {
        num_heads: usize,
    },
    Concat {
        second: usize,
    },
    Linear,
    LayerNorm,
    Gelu,
}

#[derive(Clone, Copy, Debug)]
pub struct Norm {
    pub group_channels: usize,
    pub activation: Activation,
    pub film: bool,
    pub mask: bool,
}

/// An operation and the sizes of its tensors.
#[derive(Clone, Debug)]
pub struct Case {
    pub operation: Operation,
    pub batch: usize,
    pub time: usize,
    pub inputs: usize,
    pub outputs: usize,
    pub memory: Memory,
    /// Bit `i` is set if leaf `i` has gradients; 0 gives all leaves gradients.
    pub tracked: u16,
    /// True if Burn recomputes cheap operations in the backward pass.
    pub checkpointing: bool,
    /// True if samples are padded, each by a different number of frames.
    pub padded: bool,
    pub seed: u64,
}

/// An output and the gradients of all inputs.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub output: Vec<f32>,
    pub gradients: Vec<(&'static str, Vec<f32>)>,
}

/// A named tensor of three sizes, some of which may be 1.
#[derive(Clone, Debug)]
pub struct Leaf {
    pub name: &'static str,
    pub shape: [usize; 3],
    pub values: Vec<f32>,
}

impl Case {
    pub fn norm(&self) -> Option<Norm> {
        match self.operation {
            Operation::Convolution { norm, .. } => norm,
            Operation::GroupNorm(norm) => Some(norm),
            _ => None,
        }
    }

    /// True if a normalization's groups have so few elements that the gradient is mostly rounding.
    pub fn few(&self) -> bool {
        let elements = match self.operation {
            Operation::LayerNorm => self.inputs,
            _ => match self.norm() {
                Some(norm) => {
                    let lengths = self.lengths();
                    let shortest = lengths.and_then(|l| l.frames().iter().copied().min());
                    norm.group_channels * shortest.unwrap_or(self.time)
                }
                None => return false,
            },
        };
        elements < 4
    }

    /// Valid frames of each padded sample: of the keys, or of the prepared input.
    pub fn lengths(&self) -> Option<Lengths> {
        let time = match self.operation {
            Operation::CrossAttention { keys, .. } => keys,
            Operation::Convolution {
                upsample: Some(even),
                ..
            } => 2 * self.time - usize::from(!even),
            _ => self.time,
        };
        let of_sample = |sample| time - (sample * 5 + self.seed as usize % 7) % time;
        self.padded
            .then(|| Lengths::new((0..self.batch).map(of_sample)))
    }

    /// Keys of each query, if queries attend to near keys only: about every fifth query has no
    /// keys.
    pub fn ranges(&self) -> Option<KeyRanges> {
        let Operation::CrossAttention {
            keys,
            reach: Some(reach),
            ..
        } = self.operation
        else {
            return None;
        };
        let lengths = self.lengths();
        let of = |sample: usize, query: usize| {
            let end = lengths
                .as_ref()
                .map_or(keys, |lengths| lengths.frames()[sample]);
            let middle = query * keys / self.time;
            match (query + sample + self.seed as usize % 5) % 5 {
                4 => middle..middle,
                _ => middle.saturating_sub(reach).min(end)..(middle + reach + 1).min(end),
            }
        };
        let of_sample = |sample| (0..self.time).map(move |query| (sample, query));
        let batch =
            (0..self.batch).map(|sample| of_sample(sample).map(|(s, q)| of(s, q)).collect());
        Some(KeyRanges::new(batch))
    }

    /// Every input tensor, `x` first.
    pub fn leaves(&self) -> Vec<Leaf> {
        let (batch, inputs, outputs) = (self.batch, self.inputs, self.outputs);
        let x = [batch, inputs, self.time];
        let mut shapes = match self.operation {
            Operation::Convolution {
                kernel,
                transposed,
                bias,
                residual,
                ..
            } => {
                let channels = if transposed {
                    [inputs, outputs]
                } else {
                    [outputs, inputs]
                };
                let mut shapes = vec![("x", x), ("weight", [channels[0], channels[1], kernel])];
                if bias {
                    shapes.push(("bias", [1, outputs, 1]));
                }
                if residual {
                    shapes.push(("residual", [batch, outputs, self.frames()]));
                }
                shapes
            }
            Operation::GroupNorm(_) | Operation::Gelu => vec![("x", x)],
            Operation::LayerNorm => vec![
                ("x", x),
                ("norm_weight", [1, inputs, 1]),
                ("norm_bias", [1, inputs, 1]),
            ],
            Operation::CrossAttention { keys, .. } => {
                vec![("x", x), ("keys_values", [batch, 2 * inputs, keys])]
            }
            Operation::SelfAttention { .. } => vec![("x", [batch, 3 * inputs, self.time])],
            Operation::Concat { second } => vec![("x", x), ("second", [batch, second, self.time])],
            Operation::Linear => {
                vec![
                    ("x", x),
                    ("weight", [1, outputs, inputs]),
                    ("bias", [1, outputs, 1]),
                ]
            }
        };
        if let Some(norm) = self.norm() {
            shapes.push(("norm_weight", [1, inputs, 1]));
            shapes.push(("norm_bias", [1, inputs, 1]));
            if norm.film {
                shapes.push(("film", [1, batch, 2 * inputs]));
            }
            if norm.mask {
                shapes.push(("mask", x));
            }
        }
        let key = Key::new(self.seed, Purpose::Noise);
        shapes
            .into_iter()
            .map(|(name, shape)| Leaf {
                name,
                shape,
                values: key.named(name).normals(shape.iter().product()),
            })
            .collect()
    }

    /// Frames of the output.
    pub fn frames(&self) -> usize {
        match self.operation {
            Operation::Convolution {
                kernel,
                stride,
                transposed,
                upsample,
                ..
            } => {
                let time = match upsample {
                    Some(even) => 2 * self.time - usize::from(!even),
                    None => self.time,
                };
                if transposed {
                    (time - 1) * stride + kernel - 2 * padding(kernel)
                } else {
                    time.div_ceil(stride)
                }
            }
            _ => self.time,
        }
    }

    /// Output and gradients; the loss is the output's product with a random cotangent.
    pub fn run(&self, mode: Mode, leaves: &[Leaf]) -> Outcome {
        mode.scope(|| {
            let device = Device::flex().autodiff();
            let device = if self.checkpointing {
                device.gradient_checkpointing()
            } else {
                device
            };
            let is_tracked = |index: usize| {
                let mask = self.tracked & ((1 << leaves.len()) - 1);
                leaves[index].name != "mask" && (mask.count_ones() < 2 || mask >> index & 1 == 1)
            };
            let load = |(index, leaf): (usize, &Leaf)| {
                let tensor = self.load(leaf, &device);
                tensor.set_require_grad(is_tracked(index))
            };
            let tensors: Vec<Tensor<3>> = leaves.iter().enumerate().map(load).collect();
            let named = |name: &str| {
                let index = leaves.iter().position(|leaf| leaf.name == name)?;
                Some(self.present(&leaves[index], tensors[index].clone()))
            };
            let y = self.apply(named);
            let cotangent =
                Key::new(self.seed, Purpose::CondDropout).normals(y.shape().num_elements());
            let cotangent = Tensor::<3>::from_data(TensorData::new(cotangent, y.dims()), &device);
            let output = host_values(y.clone().inner());
            let mut gradients = (y * cotangent).sum().backward();
            let gradients = leaves
                .iter()
                .zip(&tensors)
                .enumerate()
                .filter(|(index, _)| is_tracked(*index))
                .map(|(_, (leaf, tensor))| {
                    let gradient = tensor.grad_remove(&mut gradients).expect(leaf.name);
                    (leaf.name, host_values(self.present(leaf, gradient)))
                })
                .collect();
            Outcome { output, gradients }
        })
    }

    /// The output alone, on the device without gradients.
    pub fn infer(&self, mode: Mode, leaves: &[Leaf]) -> Vec<f32> {
        mode.scope(|| {
            let device = Device::flex();
            let named = |name: &str| {
                let leaf = leaves.iter().find(|leaf| leaf.name == name)?;
                Some(self.present(leaf, self.load(leaf, &device)))
            };
            host_values(self.apply(named))
        })
    }

    /// The leaf in the memory that [`present`](Self::present) views in the leaf's shape.
    fn load(&self, leaf: &Leaf, device: &Device) -> Tensor<3> {
        let [batch, channels, time] = leaf.shape;
        let tensor = |values: Vec<f32>, shape: [usize; 3]| {
            Tensor::from_data(TensorData::new(values, shape), device)
        };
        match self.memory_of(leaf) {
            Memory::Contiguous => tensor(leaf.values.clone(), leaf.shape),
            Memory::ChannelsLast => {
                let mut values = Vec::with_capacity(leaf.values.len());
                for sample in leaf.values.chunks(channels * time) {
                    for t in 0..time {
                        values.extend((0..channels).map(|c| sample[c * time + t]));
                    }
                }
                tensor(values, [batch, time, channels])
            }
            Memory::Flipped => {
                let lines = leaf.values.chunks(time);
                let values = lines.flat_map(|line| line.iter().rev().copied());
                tensor(values.collect(), leaf.shape)
            }
            Memory::Part => {
                let mut values = Vec::new();
                for sample in leaf.values.chunks(channels * time) {
                    values.extend(vec![7.0; 2 * time]);
                    values.extend(sample);
                    values.extend(vec![-7.0; time]);
                }
                tensor(values, [batch, channels + 3, time])
            }
        }
    }

    fn present(&self, leaf: &Leaf, tensor: Tensor<3>) -> Tensor<3> {
        match self.memory_of(leaf) {
            Memory::Contiguous => tensor,
            Memory::ChannelsLast => tensor.swap_dims(1, 2),
            Memory::Part => tensor.narrow(1, 2, leaf.shape[1]),
            Memory::Flipped => tensor.flip([2]),
        }
    }

    fn memory_of(&self, leaf: &Leaf) -> Memory {
        let frames = ["x", "residual", "mask", "keys_values", "second"];
        if frames.contains(&leaf.name) {
            self.memory
        } else {
            Memory::Contiguous
        }
    }

    fn apply(&self, named: impl Fn(&str) -> Option<Tensor<3>>) -> Tensor<3> {
        let take = |name: &str| named(name).expect("a tensor of the operation");
        let flat = |name: &str| {
            let tensor = take(name);
            let len = tensor.shape().num_elements();
            tensor.reshape([len])
        };
        let norm = |norm: Norm| {
            let groups = self.inputs / norm.group_channels;
            let operation = GroupNorm::new(flat("norm_weight"), flat("norm_bias"), groups, 1e-5)
                .activation(norm.activation)
                .mask(named("mask"))
                .lengths(self.lengths());
            if norm.film {
                operation.film(take("film").squeeze_dim(0))
            } else {
                operation
            }
        };
        let x = take("x");
        match self.operation {
            Operation::Convolution {
                kernel,
                stride,
                transposed,
                upsample,
                norm: settings,
                residual,
                bias,
            } => {
                let weight = take("weight");
                let mut operation = if transposed {
                    Convolution::transposed(weight, stride, padding(kernel))
                } else {
                    Convolution::new(weight, stride)
                };
                if bias {
                    operation = operation.bias(flat("bias"));
                }
                if residual {
                    operation = operation.residual(take("residual"));
                }
                if let Some(settings) = settings {
                    operation = operation.norm(norm(settings));
                }
                if let Some(even) = upsample {
                    operation = operation.upsample(2 * self.time - usize::from(!even));
                }
                if settings.is_none() {
                    operation = operation.lengths(self.lengths());
                }
                operation.forward(x)
            }
            Operation::GroupNorm(settings) => norm(settings).forward(x),
            Operation::CrossAttention { num_heads, .. } => {
                let keys_values = take("keys_values");
                match self.ranges() {
                    Some(ranges) => ranged_attention(x, keys_values, num_heads, &ranges),
                    None => cross_attention(x, keys_values, num_heads, self.lengths().as_ref()),
                }
            }
            Operation::SelfAttention { num_heads } => {
                self_attention(x, num_heads, self.lengths().as_ref())
            }
            Operation::Concat { .. } => concat_channels(x, take("second")),
            Operation::Gelu => gelu(x.mul_scalar(3.0)),
            Operation::LayerNorm => {
                let rows = x
                    .swap_dims(1, 2)
                    .reshape([self.batch * self.time, self.inputs]);
                layer_norm(rows, flat("norm_weight"), flat("norm_bias"), 1e-5)
                    .reshape([self.batch, self.time, self.inputs])
                    .swap_dims(1, 2)
            }
            Operation::Linear => {
                let rows = x
                    .swap_dims(1, 2)
                    .reshape([self.batch * self.time, self.inputs]);
                let weight = take("weight").squeeze_dim(0);
                linear(rows, weight, flat("bias"))
                    .reshape([self.batch, self.time, self.outputs])
                    .swap_dims(1, 2)
            }
        }
    }
}

/// Half of an odd kernel; 1 for a transposed kernel of 4 taps.
pub fn padding(kernel: usize) -> usize {
    (kernel - 1) / 2
}

/// The largest distance over the largest magnitude; infinite if a value is not finite.
pub fn distance(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len(), "elements");
    let (mut furthest, mut scale) = (0.0_f64, 0.0_f64);
    for (found, expected) in found.iter().zip(expected) {
        let (found, expected) = (f64::from(*found), f64::from(*expected));
        // `f64::max` would ignore NaN.
        if !found.is_finite() || !expected.is_finite() {
            return f64::INFINITY;
        }
        furthest = furthest.max((found - expected).abs());
        scale = scale.max(expected.abs());
    }
    if furthest == 0.0 {
        0.0
    } else {
        furthest / scale
    }
}
