//! What stands between a network's input and its output.

use std::fmt::Arguments;

use burn::tensor::Tensor;

/// Is told what comes out of each stage of a forward pass. The empty tuple is told and forgets, at
/// no cost: nothing is named, kept or computed for it.
pub trait Stages {
    /// The stage `name` gave what `output` answers.
    fn stage<const D: usize>(&mut self, name: Arguments<'_>, output: impl FnOnce() -> Tensor<D>);
}

impl Stages for () {
    fn stage<const D: usize>(&mut self, _: Arguments<'_>, _: impl FnOnce() -> Tensor<D>) {}
}
