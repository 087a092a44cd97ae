use std::path::{Path, PathBuf};

use super::{Checkpoints, State, Weights, read_weights};
use crate::Error;

/// Resolves a path to a checkpoint: the path itself, or the best checkpoint of a run (the latest
/// valid one if no best is recorded). `skipped` is called for each damaged one.
///
/// # Errors
/// If the path is neither a run nor a checkpoint.
pub fn resolve_checkpoint(path: &Path, mut skipped: impl FnMut(&Error)) -> Result<PathBuf, Error> {
    if path.join("state.json").exists() {
        return Ok(path.to_path_buf());
    }
    let checkpoints = Checkpoints::of(path);
    if let Some(best) = checkpoints.best() {
        let path = checkpoints.step_path(best.step);
        let readable = State::read(&path)
            .and_then(|state| read_weights(&path, &state, Weights::Ema).map(|_| ()));
        match readable {
            Ok(()) => return Ok(path),
            Err(error @ Error::CheckpointDamaged { .. }) => skipped(&error),
            Err(error) => return Err(error),
        }
    }
    match checkpoints.newest_good(skipped)? {
        Some(checkpoint) => Ok(checkpoints.step_path(checkpoint.state.step)),
        None => Err(Error::RunMissing {
            path: path.to_path_buf(),
            hint: "give a run's folder, such as runs/quickstart, or one of its checkpoints".into(),
        }),
    }
}
