//! Checkpoints: a self-contained folder of safetensors files and one `state.json`.
//!
//! A checkpoint is written under a temporary name, flushed and renamed, so a crash at any point
//! leaves the earlier ones usable; checksums are verified when a checkpoint is read.

mod folder;
mod resolve;
mod saved;
mod state;
mod tensors;
#[cfg(test)]
mod tests;

pub(crate) use folder::Unfinished;
pub use folder::{Checkpoints, must_be_free, write_weights};
pub use resolve::resolve_checkpoint;
pub use saved::SavedCheckpoint;
pub use state::{Best, FORMAT, Progress, State};
pub use tensors::Weights;

use std::path::Path;

use kinegrad_models::parameters::{HostParameter, ParameterInfo};

use crate::Error;
use crate::optim::Moments;

/// Everything needed to resume a run.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// Config, step, statistics, progress.
    pub state: State,
    /// The weights being trained.
    pub model: Vec<HostParameter>,
    /// Their moving average.
    pub ema: Vec<HostParameter>,
    /// The optimizer's running means, in the order of `model`.
    pub moments: Vec<Moments>,
}

impl Checkpoint {
    /// Reads and verifies the complete checkpoint in `path`.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let state = State::read(path)?;
        let model = tensors::read(path, &state, Weights::Model.file())?;
        let ema = tensors::read(path, &state, Weights::Ema.file())?;
        let infos: Vec<ParameterInfo> = model.iter().map(|p| p.info.clone()).collect();
        if !ema.iter().map(|p| &p.info).eq(&infos) {
            return Err(Error::CheckpointDamaged {
                path: path.to_path_buf(),
                reason: "the averaged weights are of other tensors than the weights".into(),
            });
        }
        let moments = tensors::read_optimizer(path, &state, &infos)?;
        Ok(Self {
            state,
            model,
            ema,
            moments,
        })
    }
}

/// True if all values are finite.
pub(crate) fn are_finite(values: &[f32]) -> bool {
    // Without branches, which is faster.
    let values = values.iter();
    values.fold(true, |all, value| all & value.is_finite())
}

/// A description of the first weight with an infinity or NaN.
pub(crate) fn broken_weights(
    weights: Weights,
    infos: &[ParameterInfo],
    values: &[Vec<f32>],
) -> Option<String> {
    let index = values.iter().position(|values| !are_finite(values))?;
    let what = match weights {
        Weights::Model => "the parameter",
        Weights::Ema => "the averaged parameter",
    };
    Some(format!("{what} `{}`", infos[index].name))
}

/// A description of the first running mean with an infinity or NaN.
pub(crate) fn broken_moments(infos: &[ParameterInfo], moments: &[Moments]) -> Option<String> {
    let means = |m: &Moments| are_finite(&m.exp_avg) && are_finite(&m.exp_avg_sq);
    let index = moments.iter().position(|moments| !means(moments))?;
    Some(format!(
        "the optimiser's running mean of `{}`",
        infos[index].name
    ))
}
