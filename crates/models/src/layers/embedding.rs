use burn::module::{Module, Param};
use burn::tensor::{Int, Tensor};

use crate::Initializer;

/// One learned row per entry: weight `[things, features]`, as in torch.
#[derive(Module, Debug)]
pub struct Embedding {
    weight: Param<Tensor<2>>,
}

impl Embedding {
    /// `things` rows of `features`, initialized like a linear layer with `features` inputs.
    pub fn new(things: usize, features: usize, init: &Initializer) -> Self {
        Self {
            weight: init.uniform("weight", [things, features], features),
        }
    }

    /// `captions` rows with variance 1, one per caption, at `embed_captions` in `init`.
    pub fn of_captions(captions: usize, features: usize, init: &Initializer) -> Self {
        let init = init.at("embed_captions");
        Self {
            weight: init.bounded("weight", [captions, features], 3f64.sqrt()),
        }
    }

    /// The sum of all rows, weighted by `shares`.
    ///
    /// # Shapes
    /// - shares: `[rows, things]`
    /// - output: `[rows, features]`
    pub fn mixed(&self, shares: Tensor<2>) -> Tensor<2> {
        shares.matmul(self.weight.val())
    }

    /// # Shapes
    /// - indices: `[rows]`
    /// - output: `[rows, features]`
    pub fn forward(&self, indices: Tensor<1, Int>) -> Tensor<2> {
        self.weight.val().select(0, indices)
    }
}
