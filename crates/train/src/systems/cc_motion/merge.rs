//! Merging LoRA adapters into the weights.

use std::path::{Path, PathBuf};

use kinegrad_models::{MotionModel, parameters};

use super::CcMotionConfig;
use super::networks::networks;
use crate::checkpoint::{State, Weights, must_be_free, read_weights, write_weights};
use crate::config::SystemTables;
use crate::error::Error;

/// Adds the adapters of the checkpoint in `path` to the weights they sit on, and writes the result
/// as the only checkpoint of a run in `out`, a new or an empty folder. Samples are drawn
/// from it and trainings start from it; it has no optimiser to resume with. Returns where the
/// checkpoint is.
///
/// # Errors
/// If the checkpoint is damaged or has no adapters, or `out` cannot be written.
pub fn merge(path: &Path, out: &Path) -> Result<PathBuf, Error> {
    let mut state = State::read(path)?;
    let mut config = CcMotionConfig::of(&state.config)?;
    if config.lora.is_none() {
        return Err(Error::NoAdapters {
            path: path.to_path_buf(),
        });
    }
    must_be_free(out)?;
    let device = burn::tensor::Device::flex();
    let merged = |weights: Weights| -> Result<_, Error> {
        state.statistics_of(&kinegrad_motion::Phrases)?;
        let fresh = networks(&state.config, state.normalization(), &device)?;
        let model = parameters::load(fresh, read_weights(path, &state, weights)?)?;
        let model = MotionModel {
            unet: model.unet.merge_adapters(),
            decoder: model.decoder,
        };
        Ok((parameters::infos(&model), parameters::values(&model)))
    };
    let (infos, model) = merged(Weights::Model)?;
    let (_, ema) = merged(Weights::Ema)?;
    config.lora = None;
    state.config.system = config.to_table();
    write_weights(out, &state, &infos, &model, &ema)
}
