//! The gradient of a step, in the optimizer's memory.

use std::rc::Rc;

use burn::module::Module;
use burn::tensor::{Device, Tensor, Transaction};
use kinegrad_kernels::optimizer;
use kinegrad_models::GradientSum;
use kinegrad_ranks::add;

use super::exchange::Exchange;
use super::rows::{Layout, Rows};
use crate::optim;
use crate::process_group::ProcessGroup;

/// The gradients of all parameters.
pub(super) enum StepGradients {
    /// In main memory, in the module's order.
    Host(Vec<Vec<f32>>),
    /// On the device of the networks.
    Device(Rows),
    /// The sums over several ranks.
    Ranks(Exchange),
}

impl StepGradients {
    /// The gradients of `model`, on the device with a layout and otherwise in main memory, and
    /// `numbers`.
    pub fn of<M: Module>(
        sum: GradientSum,
        model: &M,
        numbers: Vec<Tensor<1>>,
        on_device: Option<&Rc<Layout>>,
        device: &Device,
    ) -> (Self, Vec<f64>) {
        match on_device {
            Some(layout) => {
                let rows = Rows::joined(layout, &sum.into_tensors(), device);
                (Self::Device(rows), read(numbers))
            }
            None => {
                let (gradients, numbers) = sum.into_host_with(model, numbers);
                let numbers = numbers.into_iter().flatten().map(f64::from);
                (Self::Host(gradients), numbers.collect())
            }
        }
    }

    /// Adds the gradients of another micro-batch, in the same memory.
    pub fn add(&mut self, other: Self) {
        match (self, other) {
            (Self::Host(sums), Self::Host(others)) => {
                let pairs = sums.iter_mut().zip(&others);
                pairs.for_each(|(sum, other)| add(sum, other));
            }
            (Self::Device(sums), Self::Device(others)) => {
                let pairs = sums.rows.iter_mut().zip(others.rows);
                pairs.for_each(|(sum, other)| *sum = sum.clone() + other);
            }
            _ => unreachable!("gradients of one optimiser"),
        }
    }

    /// Divides all gradients.
    pub fn divide(&mut self, divisor: f64) {
        match self {
            Self::Host(sums) => {
                let sums = sums.iter_mut();
                sums.for_each(|sum| optimizer::divide(sum, divisor));
            }
            Self::Device(sums) => {
                let sums = sums.rows.iter_mut();
                sums.for_each(|sum| *sum = sum.clone().div_scalar(divisor));
            }
            Self::Ranks(_) => unreachable!("divided by the exchange"),
        }
    }

    /// The sum of the squares of each parameter's or row's gradient. Collective.
    pub fn squares(&self, group: &ProcessGroup) -> Vec<f64> {
        match self {
            Self::Host(gradients) => optim::squares(gradients),
            Self::Ranks(exchange) => exchange.squares(group),
            Self::Device(gradients) => {
                let parts: Vec<Tensor<1>> = gradients.rows.iter().map(squares_of_parts).collect();
                let counts: Vec<usize> = parts.iter().map(|parts| parts.dims()[0]).collect();
                let read = read(parts);
                let mut rest = &read[..];
                let of_row = |count| {
                    let (parts, behind) = rest.split_at(count);
                    rest = behind;
                    parts.iter().sum()
                };
                counts.into_iter().map(of_row).collect()
            }
        }
    }
}

/// Number of squares added up on the device; longer sums in single precision are inexact.
const PART: usize = 4096;

/// The sums of the squares of a row, part by part.
fn squares_of_parts(row: &Tensor<1>) -> Tensor<1> {
    let [length] = row.dims();
    let (parts, full) = (length / PART, length / PART * PART);
    let square = |first, count| row.clone().narrow(0, first, count).square();
    let mut sums = Vec::new();
    if parts > 0 {
        let squares = square(0, full).reshape([parts, PART]);
        sums.push(squares.sum_dim(1).reshape([parts]));
    }
    if full < length {
        sums.push(square(full, length - full).sum());
    }
    Tensor::cat(sums, 0)
}

/// The concatenated values of tensors, in one read.
fn read(tensors: Vec<Tensor<1>>) -> Vec<f64> {
    let read = tensors
        .into_iter()
        .fold(Transaction::default(), Transaction::register);
    let read = read.execute().into_iter().flat_map(|data| {
        let values = data.convert::<f32>().try_into_vec::<f32>();
        values.expect("losses are float32")
    });
    read.map(f64::from).collect()
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;

    #[test]
    fn the_norm_of_a_long_row_is_that_of_the_host() {
        let device = Device::flex();
        let lengths = [3_000_000, 5, PART, 70];
        let value = |i: usize| 1e-3 * (1.0 + (i as f32 * 0.37).sin());
        let host: Vec<Vec<f32>> = lengths.map(|n| (0..n).map(value).collect()).to_vec();
        let tensors = host.iter().map(|values| {
            let data = TensorData::new(values.clone(), [values.len()]);
            Some(Tensor::from_data(data, &device))
        });
        // The last parameter has a separate row.
        let layout = Layout::new(&lengths, |index| index == 3);
        let rows = Rows::joined(&layout, &tensors.collect::<Vec<_>>(), &device);
        let sum = |squares: Vec<f64>| squares.iter().sum::<f64>();
        let alone = ProcessGroup::alone();
        let found = StepGradients::Device(rows).squares(&alone);
        assert_eq!(found.len(), 2);
        let (found, expected) = (sum(found), sum(StepGradients::Host(host).squares(&alone)));
        assert!((found / expected - 1.0).abs() < 1e-8, "{found} {expected}");
    }
}
