//! Dropout with masks from a random key: a resumed step drops the same elements.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::Key;

/// The random key of a forward pass's masks. In training the key depends on step, micro-batch and
/// call. `None` disables dropout (validation, sampling, rollouts).
pub type DropoutKey = Option<Key>;

/// Inverted dropout: elements are zeroed with probability `prob`; other elements are scaled by `1 /
/// (1 - prob)`.
#[derive(Module, Debug)]
pub struct Dropout {
    prob: f64,
    layer: usize,
}

impl Dropout {
    /// Dropout of probability `prob`; `layer` is the index among the network's dropout layers.
    pub fn new(prob: f64, layer: usize) -> Self {
        Self { prob, layer }
    }

    /// True if anything is dropped with `key`.
    pub fn drops(&self, key: DropoutKey) -> bool {
        key.is_some() && self.prob > 0.0
    }

    /// Applies the mask of `key`; returns `x` without a key.
    ///
    /// # Shapes
    /// - x, output: any
    pub fn forward<const D: usize>(&self, x: Tensor<D>, key: DropoutKey) -> Tensor<D> {
        match self.mask(x.dims(), &x.device(), key) {
            Some(mask) => x * mask,
            None => x,
        }
    }

    /// The factors of `key` for a tensor of this shape; `None` without a key.
    pub fn mask<const D: usize>(
        &self,
        shape: [usize; D],
        device: &Device,
        key: DropoutKey,
    ) -> Option<Tensor<D>> {
        let key = key.filter(|_| self.drops(key))?;
        let mask = key
            .at(self.layer as u64)
            .dropout_mask(shape.iter().product(), self.prob);
        Some(Tensor::from_data(TensorData::new(mask, shape), device))
    }
}
