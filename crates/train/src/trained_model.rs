//! Trained models for sampling and evaluation.

use burn::module::Module;
use burn::tensor::Device;

use crate::checkpoint::{SavedCheckpoint, Weights};
use crate::config::Config;
use crate::error::Error;
use std::path::Path;

/// A checkpoint to sample or evaluate, and its device.
#[derive(Clone, Debug)]
pub struct TrainedModel {
    /// The checkpoint; its config contains the system's tables and the overrides.
    pub saved: SavedCheckpoint,
    /// The trained weights, or their moving average.
    pub weights: Weights,
    /// The device to run on, without gradients.
    pub device: Device,
    /// The keys of the config that overrides changed, with their values as JSON.
    pub overridden: Vec<(String, String)>,
    /// True for the CPU, which computes in main memory.
    pub on_host: bool,
}

impl TrainedModel {
    /// The config of its run.
    pub fn config(&self) -> &Config {
        &self.saved.state.config
    }

    /// The checkpoint's folder.
    pub fn path(&self) -> &Path {
        &self.saved.path
    }

    /// `network`, built from the config, with the weights to use.
    ///
    /// # Errors
    /// As [`SavedCheckpoint::load`].
    pub fn load<M: Module>(&self, network: M) -> Result<M, Error> {
        self.saved.load(network, self.weights)
    }

    /// The model of another checkpoint with the same kind of weights and device.
    #[must_use]
    pub fn beside(&self, saved: SavedCheckpoint) -> Self {
        Self {
            saved,
            device: self.device.clone(),
            overridden: Vec::new(),
            ..*self
        }
    }
}
