use std::path::Path;

use super::{Checkpoints, SavedCheckpoint, Weights};
use crate::Error;

/// The checkpoint that `path` names: the checkpoint itself, or the best one of a run (the latest valid
/// one if no best is recorded). `skipped` is called for each damaged one.
///
/// # Errors
/// If the path is neither a run nor a checkpoint.
pub fn resolve_checkpoint(
    path: &Path,
    mut skipped: impl FnMut(&Error),
) -> Result<SavedCheckpoint, Error> {
    if path.join("state.json").exists() {
        return SavedCheckpoint::read(path);
    }
    let checkpoints = Checkpoints::of(path);
    if let Some(best) = checkpoints.best() {
        let saved = SavedCheckpoint::read(&checkpoints.step_path(best.step))
            .and_then(|saved| saved.weights(Weights::Ema).map(|_| saved));
        match saved {
            Ok(saved) => return Ok(saved),
            Err(error @ Error::CheckpointDamaged { .. }) => skipped(&error),
            Err(error) => return Err(error),
        }
    }
    match checkpoints.newest_good(skipped)? {
        Some(checkpoint) => Ok(SavedCheckpoint {
            path: checkpoints.step_path(checkpoint.state.step),
            state: checkpoint.state,
        }),
        None => Err(Error::RunMissing {
            path: path.to_path_buf(),
            hint: "give a run's folder, such as runs/quickstart, or one of its checkpoints".into(),
        }),
    }
}
