//! Merging LoRA adapters into the weights.

use std::path::{Path, PathBuf};

use kinegrad_models::parameters;
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights, must_be_free, write_weights};
use kinegrad_train::config::OwnTables;
use kinegrad_train::{Error, System};

use super::load::networks;
use super::{CcMotion, CcMotionConfig};
use crate::network::MotionModel;

/// Merges the adapters of the checkpoint `saved` into the weights. Writes the result without
/// optimizer state as the only checkpoint of a run in `out`, a new or empty folder. Returns the
/// path of the checkpoint.
pub(super) fn merge(saved: SavedCheckpoint, out: &Path) -> Result<PathBuf, Error> {
    let saved = (&CcMotion as &dyn System).read_tables(saved)?;
    let mut state = saved.state.clone();
    let mut config = state.config.own::<CcMotionConfig>().clone();
    if config.lora.is_none() {
        return Err(Error::NoAdapters { path: saved.path });
    }
    must_be_free(out)?;
    let device = burn::tensor::Device::flex();
    let merged = |weights: Weights| -> Result<_, Error> {
        state.statistics_of(&kinegrad_motion::Phrases)?;
        let fresh = networks(&state.config, state.normalization(), &device)?;
        let model = parameters::load(fresh, saved.weights(weights)?)?;
        let model = MotionModel {
            unet: model.unet.merge_adapters(),
            decoder: model.decoder,
        };
        Ok((parameters::infos(&model), parameters::values(&model)))
    };
    let (infos, model) = merged(Weights::Model)?;
    let (_, ema) = merged(Weights::Ema)?;
    config.lora = None;
    state.config.system = OwnTables::new(config);
    write_weights(out, &state, &infos, &model, &ema)
}
