//! A slow reference of the operations in double precision; gradients are finite differences.

use proptest::prelude::*;

use super::cases::{Case, Leaf, Norm, Operation, padding};
use super::fused::cases;
use crate::{Activation, Mode};
use kinegrad_random::{Key, Purpose};

/// `[batch, channels, time]` in double precision.
#[derive(Clone)]
struct Frames {
    shape: [usize; 3],
    values: Vec<f64>,
}

impl Frames {
    fn zeros(shape: [usize; 3]) -> Self {
        Self {
            shape,
            values: vec![0.0; shape.iter().product()],
        }
    }

    fn from_fn(shape: [usize; 3], value: impl Fn(usize, usize, usize) -> f64) -> Self {
        let mut frames = Self::zeros(shape);
        for b in 0..shape[0] {
            for c in 0..shape[1] {
                for t in 0..shape[2] {
                    *frames.at_mut(b, c, t) = value(b, c, t);
                }
            }
        }
        frames
    }

    fn at(&self, b: usize, c: usize, t: usize) -> f64 {
        self.values[(b * self.shape[1] + c) * self.shape[2] + t]
    }

    fn at_mut(&mut self, b: usize, c: usize, t: usize) -> &mut f64 {
        &mut self.values[(b * self.shape[1] + c) * self.shape[2] + t]
    }
}

struct Tensors<'a>(&'a [(&'static str, Frames)]);

impl Tensors<'_> {
    fn find(&self, name: &str) -> Option<&Frames> {
        self.0
            .iter()
            .find(|(n, _)| *n == name)
            .map(|(_, frames)| frames)
    }

    fn get(&self, name: &str) -> &Frames {
        self.find(name).expect("a tensor of the operation")
    }
}

fn evaluate(case: &Case, tensors: &Tensors<'_>) -> Frames {
    let x = tensors.get("x").clone();
    let lengths = case.lengths();
    let counts = |b: usize, t: usize| lengths.as_ref().is_none_or(|l| t < l.frames()[b]);
    match case.operation {
        Operation::Convolution {
            kernel,
            stride,
            transposed,
            upsample,
            norm,
            ..
        } => {
            let x = match norm {
                Some(norm) => group_norm(x, norm, tensors, &counts),
                None => x,
            };
            let x = match upsample {
                Some(even) => {
                    let frames = 2 * x.shape[2] - usize::from(!even);
                    let shape = [x.shape[0], x.shape[1], frames];
                    Frames::from_fn(shape, |b, c, t| x.at(b, c, t / 2))
                }
                None => x,
            };
            let x = Frames::from_fn(
                x.shape,
                |b, c, t| if counts(b, t) { x.at(b, c, t) } else { 0.0 },
            );
            let mut y = Frames::zeros([case.batch, case.outputs, case.frames()]);
            if let Some(residual) = tensors.find("residual") {
                y = residual.clone();
            }
            let weight = tensors.get("weight");
            let [long, short] = if transposed {
                [y.shape[2], x.shape[2]]
            } else {
                [x.shape[2], y.shape[2]]
            };
            for b in 0..case.batch {
                for o in 0..case.outputs {
                    let bias = tensors.find("bias").map_or(0.0, |bias| bias.at(0, o, 0));
                    for t in 0..y.shape[2] {
                        *y.at_mut(b, o, t) += bias;
                    }
                    for i in 0..case.inputs {
                        for s in 0..short {
                            for k in 0..kernel {
                                let Some(l) = (s * stride + k).checked_sub(padding(kernel)) else {
                                    continue;
                                };
                                if l >= long {
                                    continue;
                                }
                                if transposed {
                                    *y.at_mut(b, o, l) += x.at(b, i, s) * weight.at(i, o, k);
                                } else {
                                    *y.at_mut(b, o, s) += x.at(b, i, l) * weight.at(o, i, k);
                                }
                            }
                        }
                    }
                }
            }
            y
        }
        Operation::GroupNorm(norm) => group_norm(x, norm, tensors, &counts),
        Operation::CrossAttention { num_heads, .. } => {
            let other = tensors.get("keys_values");
            let ranges = case.ranges();
            let counts = |b: usize, t: usize, key: usize| match &ranges {
                Some(ranges) => ranges.of(b, t).contains(&key),
                None => counts(b, key),
            };
            attention(
                case,
                num_heads,
                &x,
                (other, 0),
                (other, case.inputs),
                &counts,
            )
        }
        Operation::SelfAttention { num_heads } => attention(
            case,
            num_heads,
            &x,
            (&x, case.inputs),
            (&x, 2 * case.inputs),
            &|b, _, key| counts(b, key),
        ),
        Operation::Concat { second: channels } => {
            let second = tensors.get("second");
            let shape = [case.batch, case.inputs + channels, case.time];
            Frames::from_fn(shape, |b, c, t| {
                if c < case.inputs {
                    x.at(b, c, t)
                } else {
                    second.at(b, c - case.inputs, t)
                }
            })
        }
        Operation::Gelu => Frames::from_fn(x.shape, |b, c, t| {
            let u = 3.0 * x.at(b, c, t);
            u * (1.0 + erf(u / 2.0_f64.sqrt())) / 2.0
        }),
        Operation::LayerNorm => {
            let norm = Norm {
                group_channels: case.inputs,
                activation: Activation::None,
                film: false,
                mask: false,
            };
            // Rows are samples of one frame.
            let turned = Frames::from_fn([case.batch * case.time, case.inputs, 1], |r, c, _| {
                x.at(r / case.time, c, r % case.time)
            });
            let y = group_norm(turned, norm, tensors, &|_, _| true);
            Frames::from_fn(x.shape, |b, c, t| y.at(b * case.time + t, c, 0))
        }
        Operation::Linear => {
            let (weight, bias) = (tensors.get("weight"), tensors.get("bias"));
            Frames::from_fn([case.batch, case.outputs, case.time], |b, o, t| {
                let products = (0..case.inputs).map(|i| x.at(b, i, t) * weight.at(0, o, i));
                products.sum::<f64>() + bias.at(0, o, 0)
            })
        }
    }
}

/// The error function by its series, exact to 1e-10 in the range of the tests.
fn erf(x: f64) -> f64 {
    if x.is_nan() || x.abs() > 5.0 {
        return if x.is_nan() { x } else { x.signum() };
    }
    // This series has terms of one sign; terms of alternating sign would lose most digits.
    let (mut term, mut sum) = (x, x);
    for n in 1..200 {
        term *= 2.0 * x * x / f64::from(2 * n + 1);
        sum += term;
    }
    sum * (-x * x).exp() * 2.0 / std::f64::consts::PI.sqrt()
}

fn group_norm(
    x: Frames,
    norm: Norm,
    tensors: &Tensors<'_>,
    counts: &dyn Fn(usize, usize) -> bool,
) -> Frames {
    let [_, channels, time] = x.shape;
    let (weight, bias) = (tensors.get("norm_weight"), tensors.get("norm_bias"));
    Frames::from_fn(x.shape, |b, c, t| {
        if !counts(b, t) {
            return 0.0;
        }
        let time = (0..time).filter(|&t| counts(b, t)).count();
        let count = (norm.group_channels * time) as f64;
        let first = c / norm.group_channels * norm.group_channels;
        let group =
            || (first..first + norm.group_channels).flat_map(|c| (0..time).map(move |t| (c, t)));
        let mean = group().map(|(c, t)| x.at(b, c, t)).sum::<f64>() / count;
        let variance = group()
            .map(|(c, t)| (x.at(b, c, t) - mean).powi(2))
            .sum::<f64>()
            / count;
        let mut u = (x.at(b, c, t) - mean) / (variance + 1e-5).sqrt();
        u = u * weight.at(0, c, 0) + bias.at(0, c, 0);
        if let Some(film) = tensors.find("film") {
            u = u * (1.0 + film.at(0, b, c)) + film.at(0, b, channels + c);
        }
        let y = match norm.activation {
            Activation::None => u,
            Activation::Silu => u / (1.0 + (-u).exp()),
            Activation::Mish => u * u.exp().ln_1p().tanh(),
        };
        y * tensors.find("mask").map_or(1.0, |mask| mask.at(b, c, t))
    })
}

fn attention(
    case: &Case,
    num_heads: usize,
    queries: &Frames,
    (keys, first_key): (&Frames, usize),
    (values, first_value): (&Frames, usize),
    counts: &dyn Fn(usize, usize, usize) -> bool,
) -> Frames {
    let head = case.inputs / num_heads;
    Frames::from_fn([case.batch, case.inputs, case.time], |b, c, t| {
        let first = c / head * head;
        let attended = (0..keys.shape[2]).filter(|&s| counts(b, t, s));
        let weights = attended.map(|s| {
            let products =
                (first..first + head).map(|c| queries.at(b, c, t) * keys.at(b, first_key + c, s));
            (s, (products.sum::<f64>() / (head as f64).sqrt()).exp())
        });
        let weights: Vec<(usize, f64)> = weights.collect();
        let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
        let products = weights
            .iter()
            .map(|(s, w)| w * values.at(b, first_value + c, *s));
        match weights.is_empty() {
            true => 0.0,
            false => products.sum::<f64>() / total,
        }
    })
}

fn loss(case: &Case, tensors: &Tensors<'_>, cotangent: &[f32]) -> f64 {
    let y = evaluate(case, tensors);
    y.values
        .iter()
        .zip(cotangent)
        .map(|(y, c)| y * f64::from(*c))
        .sum()
}

fn doubled(leaves: &[Leaf]) -> Vec<(&'static str, Frames)> {
    leaves
        .iter()
        .map(|leaf| {
            let values = leaf.values.iter().map(|&v| f64::from(v)).collect();
            (
                leaf.name,
                Frames {
                    shape: leaf.shape,
                    values,
                },
            )
        })
        .collect()
}

/// The output in double precision.
pub fn reference_output(case: &Case, leaves: &[Leaf]) -> Vec<f64> {
    evaluate(case, &Tensors(&doubled(leaves))).values
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn kernels_agree_with_double_precision(
        case in cases().prop_filter("small", |case| case.outputs < 24 && case.time < 20),
        picks in prop::collection::vec(any::<usize>(), 3),
    ) {
        const STEP: f64 = 1e-5;
        let leaves = case.leaves();
        let outcome = case.run(Mode::Fused, &leaves);
        let mut tensors = doubled(&leaves);
        let expected = evaluate(&case, &Tensors(&tensors));
        // 1 + erf is of single precision: small outputs of GELU have the error of the input's size.
        let least = if matches!(case.operation, Operation::Gelu) { 0.06 } else { 1e-3 };
        let scale = expected.values.iter().fold(least, |a: f64, v| a.max(v.abs()));
        for (found, expected) in outcome.output.iter().zip(&expected.values) {
            let error = (f64::from(*found) - expected).abs() / scale;
            prop_assert!(error < 1e-5, "output {found} instead of {expected}");
        }
        let cotangent = Key::new(case.seed, Purpose::CondDropout).normals(expected.values.len());
        // The gradient of a group of few elements is mostly rounding.
        if case.few() {
            return Ok(());
        }
        for (name, gradient) in &outcome.gradients {
            let index = leaves.iter().position(|leaf| leaf.name == *name).expect("a leaf");
            let scale = gradient.iter().fold(0.1_f64, |a, v| a.max(f64::from(v.abs())));
            for pick in &picks {
                let element = pick % gradient.len();
                let value = tensors[index].1.values[element];
                let mut at = |value: f64| {
                    tensors[index].1.values[element] = value;
                    loss(&case, &Tensors(&tensors), &cotangent)
                };
                let slope = (at(value + STEP) - at(value - STEP)) / (2.0 * STEP);
                at(value);
                let error = (f64::from(gradient[element]) - slope).abs() / scale;
                prop_assert!(error < 5e-4, "gradient of {name}: {} instead of {slope}", gradient[element]);
            }
        }
    }
}
