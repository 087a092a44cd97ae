use std::path::Path;

use super::{Checkpoints, SavedCheckpoint, Weights};
use crate::Error;

/// The checkpoint `path`, or the best checkpoint of the run `path` (the latest valid checkpoint if
/// no best step is recorded). `skipped` is called for each damaged checkpoint.
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
