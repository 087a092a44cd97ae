//! Samples that are looked at while training goes on.

use super::Trainer;
use crate::error::Error;
use crate::observer::Observer;
use crate::recipe::Recipe;
use crate::run::preview_page;

impl<R: Recipe> Trainer<R> {
    /// Whether the step that was just done is one of `sampling.preview_every_steps`.
    pub(super) fn previews_are_due(&self) -> bool {
        let every = self.parts.config.sampling.preview_every_steps;
        every > 0 && self.step > 0 && self.step.is_multiple_of(every)
    }

    /// Draws what a process that ended at this step has left undone.
    pub(super) fn preview_if_missing(&mut self, observer: &mut dyn Observer) -> Result<(), Error> {
        match self.previews_are_due() {
            true => {
                let drawn = preview_page(&self.parts.folder, self.step).exists();
                self.preview(drawn, observer)
            }
            false => Ok(()),
        }
    }

    /// Lets the observer draw samples of this step's checkpoint, which is written, and records their
    /// pictures, unless they are `drawn`. Where that fails, training goes on; where it is about to stop,
    /// they are drawn when it is resumed. The rank that writes draws, and all know how that has ended.
    pub(super) fn preview(
        &mut self,
        drawn: bool,
        observer: &mut dyn Observer,
    ) -> Result<(), Error> {
        let together = self.parts.together.clone();
        let draws = together.writes() && !drawn && !observer.stop_requested();
        let recorded = match draws {
            true => self.draw_previews(observer),
            false => Ok(()),
        };
        together.done(recorded)
    }

    fn draw_previews(&mut self, observer: &mut dyn Observer) -> Result<(), Error> {
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
