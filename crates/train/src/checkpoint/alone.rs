//! Weights without an optimiser as a run of their own.

use std::path::{Path, PathBuf};

use kinegrad_models::parameters::ParameterInfo;

use super::{CheckpointRef, Checkpoints, State};
use crate::Error;

/// Rejects a folder that holds something.
pub(crate) fn must_be_free(out: &Path) -> Result<(), Error> {
    let taken = out
        .read_dir()
        .is_ok_and(|mut entries| entries.next().is_some());
    match taken || out.is_file() {
        true => Err(Error::usage(
            format!(
                "{} exists already and is not an empty folder",
                out.display()
            ),
            "choose another `--out`",
        )),
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
    Checkpoints::of(out).save(CheckpointRef {
        state,
        infos,
        model,
        ema,
        moments: &[],
    })
}
