//! The gradient of a step, where its optimiser works.

use std::rc::Rc;

use burn::module::Module;
use burn::tensor::{Device, Tensor, Transaction};
use kinegrad_kernels::optimizer;
use kinegrad_models::GradientSum;
use kinegrad_ranks::add;

use super::rows::{Layout, Rows};
use crate::optim;

/// The gradients of all parameters.
pub(super) enum StepGradients {
    /// In main memory, in the module's order.
    Host(Vec<Vec<f32>>),
    /// On the device of the networks.
    Device(Rows),
}

impl StepGradients {
    /// Gradients of `model`, on its device where they are laid out there, else in main memory.
    pub fn of<M: Module>(
        sum: GradientSum,
        model: &M,
        on_device: Option<&Rc<Layout>>,
        device: &Device,
    ) -> Self {
        match on_device {
            Some(layout) => Self::Device(Rows::joined(layout, &sum.into_tensors(), device)),
            None => Self::Host(sum.into_host(model)),
        }
    }

    /// Adds the gradients of another micro-batch, which are in the same place.
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
            _ => unreachable!("one optimiser, one place"),
        }
    }

    /// Divides all of them.
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
        }
    }

    /// The sum of the squares of each parameter's gradient, or of each row of them.
    pub fn squares(&self) -> Vec<f64> {
        match self {
            Self::Host(gradients) => optim::squares(gradients),
            Self::Device(gradients) => {
                let squares = gradients
                    .rows
                    .iter()
                    .map(|gradient| gradient.clone().square().sum());
                numbers(squares.collect())
            }
        }
    }
}

/// The values of tensors of one number each, in one read.
pub(super) fn numbers(tensors: Vec<Tensor<1>>) -> Vec<f64> {
    let read = tensors
        .into_iter()
        .fold(Transaction::default(), Transaction::register);
    let read = read.execute().into_iter().flat_map(|data| {
        let values = data.convert::<f32>().try_into_vec::<f32>();
        values.expect("losses are float32")
    });
    read.map(f64::from).collect()
}
