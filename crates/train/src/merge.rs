//! A run with low-rank adapters made into one of plain weights.

use std::path::{Path, PathBuf};

use kinegrad_models::parameters::ParameterInfo;
use kinegrad_models::{MotionModel, parameters};

use crate::checkpoint::{CheckpointRef, Checkpoints, State, Weights, read_weights};
use crate::error::Error;
use crate::optim::Moments;
use crate::trained::networks;

/// Adds the adapters of the checkpoint in `path` to the weights they sit on, and writes the result
/// as the only checkpoint of a run in `out`, a new or an empty folder. Samples are drawn
/// from it and trainings start from it; it has no optimiser to resume with. Returns where the
/// checkpoint is.
///
/// # Errors
/// If the checkpoint is damaged or has no adapters, or `out` cannot be written.
pub fn merge(path: &Path, out: &Path) -> Result<PathBuf, Error> {
    let mut state = State::read(path)?;
    if state.config.lora.is_none() {
        return Err(Error::NoAdapters {
            path: path.to_path_buf(),
        });
    }
    must_be_free(out)?;
    let device = burn::tensor::Device::flex();
    let merged = |weights: Weights| -> Result<_, Error> {
        let fresh = networks(&state.config, state.statistics.phrases()?, &device)?;
        let model = parameters::load(fresh, read_weights(path, &state, weights)?)?;
        let model = MotionModel {
            unet: model.unet.merge_adapters(),
            decoder: model.decoder,
        };
        let (infos, values) = parameters::export(&model)
            .into_iter()
            .map(|parameter| (parameter.info, parameter.values))
            .collect::<(Vec<_>, Vec<_>)>();
        Ok((infos, values))
    };
    let (infos, model) = merged(Weights::Model)?;
    let (_, ema) = merged(Weights::Ema)?;
    state.config.lora = None;
    write_weights(out, &state, &infos, &model, &ema)
}

/// Refuses a folder that holds something.
pub(crate) fn must_be_free(out: &Path) -> Result<(), Error> {
    let taken = out
        .read_dir()
        .is_ok_and(|mut entries| entries.next().is_some());
    match taken || out.is_file() {
        true => Err(Error::OutputTaken {
            path: out.to_path_buf(),
        }),
        false => Ok(()),
    }
}

/// Writes weights without an optimiser as the only checkpoint of the run in `out`.
pub(crate) fn write_weights(
    out: &Path,
    state: &State,
    infos: &[ParameterInfo],
    model: &[Vec<f32>],
    ema: &[Vec<f32>],
) -> Result<PathBuf, Error> {
    let none = Moments {
        exp_avg: Vec::new(),
        exp_avg_sq: Vec::new(),
    };
    Checkpoints::of(out).save(CheckpointRef {
        state,
        infos,
        model,
        ema,
        moments: &vec![none; infos.len()],
    })
}
