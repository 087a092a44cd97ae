use burn::module::{Module, Param};
use burn::tensor::{Int, Tensor};

use crate::Initializer;

/// A learned row for each of a fixed number of things: weight `[things, features]`, as torch's
/// `Embedding`.
#[derive(Module, Debug)]
pub struct Embedding {
    weight: Param<Tensor<2>>,
}

impl Embedding {
    /// Rows of `features` for `things` things, drawn as a linear layer of so many inputs is.
    pub fn new(things: usize, features: usize, init: &Initializer) -> Self {
        Self {
            weight: init.uniform("weight", [things, features], features),
        }
    }

    /// # Shapes
    /// - indices: `[rows]`
    /// - output: `[rows, features]`
    pub fn forward(&self, indices: Tensor<1, Int>) -> Tensor<2> {
        self.weight.val().select(0, indices)
    }
}
