//! The outputs of the stages of a forward pass.

use std::collections::HashMap;
use std::fmt::Arguments;

use burn::tensor::Tensor;
use kinegrad_models::Stages;

use crate::golden::values;

/// Shapes and values by the stage's name.
#[derive(Debug, Default)]
pub struct Noted(HashMap<String, (Vec<usize>, Vec<f32>)>);

impl Noted {
    /// The shape of the stage `name`.
    ///
    /// # Panics
    /// Panics if there was no such stage.
    pub fn shape(&self, name: &str) -> &[usize] {
        &self.get(name).0
    }

    /// The values of the stage `name`.
    ///
    /// # Panics
    /// Panics if there was no such stage.
    pub fn values(&self, name: &str) -> &[f32] {
        &self.get(name).1
    }

    fn get(&self, name: &str) -> &(Vec<usize>, Vec<f32>) {
        let found = self.0.get(name);
        found.unwrap_or_else(|| panic!("no stage `{name}`"))
    }
}

impl Stages for Noted {
    fn stage<const D: usize>(&mut self, name: Arguments<'_>, output: impl FnOnce() -> Tensor<D>) {
        let output = output();
        let shape = output.dims().to_vec();
        let before = self.0.insert(name.to_string(), (shape, values(output)));
        assert!(before.is_none(), "two stages `{name}`");
    }
}
