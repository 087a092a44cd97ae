use std::path::{Path, PathBuf};

use burn::module::Module;
use kinegrad_models::parameters::{self, HostParameter};

use super::{State, Weights, tensors};
use crate::error::Error;

/// A checkpoint whose `state.json` has been read and verified.
#[derive(Clone, Debug)]
pub struct SavedCheckpoint {
    /// Its folder.
    pub path: PathBuf,
    /// Config, step, statistics.
    pub state: State,
}

impl SavedCheckpoint {
    /// Reads `state.json` of the checkpoint in `path`.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Ok(Self {
            path: path.to_path_buf(),
            state: State::read(path)?,
        })
    }

    /// `network`, built from the checkpoint's config, with its weights.
    ///
    /// # Errors
    /// As [`weights`](Self::weights); lists all parameters that do not fit.
    pub fn load<M: Module>(&self, network: M, weights: Weights) -> Result<M, Error> {
        Ok(parameters::load(network, self.weights(weights)?)?)
    }

    /// The trained weights, or their moving average.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn weights(&self, weights: Weights) -> Result<Vec<HostParameter>, Error> {
        tensors::read(&self.path, &self.state, weights.file())
    }
}
