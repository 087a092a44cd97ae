//! Hooks on the intermediate outputs of a forward pass.

use std::fmt::Arguments;

use burn::tensor::Tensor;

/// Receives the output of each stage of a forward pass. The empty tuple ignores outputs at no cost.
pub trait Stages {
    /// Receives the `name` of a stage and a closure that returns the stage's output.
    fn stage<const D: usize>(&mut self, name: Arguments<'_>, output: impl FnOnce() -> Tensor<D>);
}

impl Stages for () {
    fn stage<const D: usize>(&mut self, _: Arguments<'_>, _: impl FnOnce() -> Tensor<D>) {}
}
