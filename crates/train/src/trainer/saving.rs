//! Writing a checkpoint part by part.

use super::Trainer;
use crate::checkpoint::{FORMAT, State, Unfinished, Weights, broken_moments, broken_weights};
use crate::error::Error;
use crate::optim::Moments;
use crate::recipe::Recipe;

/// A checkpoint that the first rank is writing.
pub(super) struct Saving<'a, R: Recipe> {
    trainer: &'a Trainer<R>,
    /// The partial checkpoint; `None` on other ranks.
    written: Result<Option<Unfinished>, Error>,
}

impl<'a, R: Recipe> Saving<'a, R> {
    /// Starts a checkpoint of the current state.
    pub fn begin(trainer: &'a Trainer<R>) -> Self {
        let writes = trainer.parts.group.writes();
        let started = writes.then(|| trainer.checkpoints.begin(trainer.step));
        Self {
            trainer,
            written: started.transpose(),
        }
    }

    /// Writes the trained weights or their average.
    pub fn weights(&mut self, weights: Weights, values: &[Vec<f32>]) {
        let infos = &self.trainer.infos;
        self.write(
            || broken_weights(weights, infos, values),
            |unfinished| unfinished.write_weights(weights, infos, values),
        );
    }

    /// Writes the optimizer's running means.
    pub fn moments(&mut self, moments: &[Moments]) {
        let infos = &self.trainer.infos;
        self.write(
            || broken_moments(infos, moments),
            |unfinished| unfinished.write_moments(infos, moments),
        );
    }

    /// Writes a part with finite values on the first rank, unless an earlier part failed.
    fn write(
        &mut self,
        broken: impl FnOnce() -> Option<String>,
        write: impl FnOnce(&mut Unfinished) -> Result<(), Error>,
    ) {
        let Ok(Some(unfinished)) = &mut self.written else {
            return;
        };
        let written = match broken() {
            Some(tensor) => Err(self.trainer.not_finite(self.trainer.step, tensor)),
            None => write(unfinished),
        };
        if let Err(error) = written {
            self.written = Err(error);
        }
    }

    /// Finishes the checkpoint, records the best step and removes older checkpoints.
    pub fn finish(self) -> Result<(), Error> {
        let Self { trainer, written } = self;
        let Some(unfinished) = written? else {
            return Ok(());
        };
        let (parts, step) = (&trainer.parts, trainer.step);
        let path = unfinished.finish(&State {
            format: FORMAT,
            kinegrad: env!("CARGO_PKG_VERSION").to_string(),
            step,
            steps_per_epoch: parts.config.train.epochs.map(|_| parts.steps_per_epoch),
            config: parts.config.clone(),
            statistics: parts.statistics.clone(),
            network_statistics: parts.network_statistics.clone(),
            dataset_sha256: Some(parts.dataset.to_string()),
            progress: trainer.progress.clone(),
            checksums: Default::default(),
        })?;
        let (checkpoints, progress) = (&trainer.checkpoints, &trainer.progress);
        checkpoints.set_best(progress.best().as_ref())?;
        let keep_last = parts.config.checkpoint.keep_last;
        checkpoints.prune(step, keep_last, progress.best_step)?;
        log::debug!("checkpoint of step {step} written: {}", path.display());
        Ok(())
    }
}
