//! Sample previews during training.

use super::Trainer;
use crate::error::Error;
use crate::observer::Observer;
use crate::recipe::Recipe;

impl<R: Recipe> Trainer<R> {
    /// True if the last step is one of `sampling.preview_every_steps`.
    pub(super) fn previews_are_due(&self) -> bool {
        let every = self.parts.config.sampling.preview_every_steps;
        every > 0 && self.step > 0 && self.step.is_multiple_of(every)
    }

    /// Lets the observer sample from this step's checkpoint and records the pictures, unless the
    /// pictures `exist`. If sampling fails, training continues. If a stop is requested, the resumed
    /// run samples. The first rank samples, and all ranks get the outcome.
    pub(super) fn preview(
        &mut self,
        exist: bool,
        observer: &mut dyn Observer,
    ) -> Result<(), Error> {
        let group = self.parts.group.clone();
        let samples = group.writes() && !exist && !observer.stop_requested();
        let recorded = match samples {
            true => self.sample_previews(observer),
            false => Ok(()),
        };
        group.done(recorded)
    }

    fn sample_previews(&mut self, observer: &mut dyn Observer) -> Result<(), Error> {
        let checkpoint = self.checkpoints.step_path(self.step);
        match observer.preview(&checkpoint, self.step) {
            Ok(previews) => {
                if let Some((metrics, _)) = &mut self.record {
                    metrics.write_previews(self.step, &previews)?;
                }
            }
            Err(error) => {
                let step = self.step;
                observer.warning(&format!("no preview of step {step}: {error}"));
            }
        }
        Ok(())
    }
}
