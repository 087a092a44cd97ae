//! Progress callbacks of a training run.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::parameter_count::ParameterCount;

/// Progress callback of a dataset with items read and total items.
pub type Reading = dyn Fn(usize, usize) -> ControlFlow<()> + Sync;

/// Callbacks of a training run.
pub trait Observer {
    /// The run has been set up and starts training (or was already finished).
    fn started(&mut self, summary: &RunSummary);
    /// An optimizer step was done.
    fn stepped(&mut self, report: &StepReport);
    /// The validation loss was computed. `validation.select_by` defines `best`.
    fn validated(&mut self, step: u64, val_loss: f64, best: bool);
    /// A checkpoint was written.
    fn saved(&mut self, path: &Path);
    /// Samples previews from the checkpoint of `step` and returns pictures for TensorBoard.
    ///
    /// # Errors
    /// If sampling fails; training warns and continues.
    fn preview(&mut self, _checkpoint: &Path, _step: u64) -> Result<Vec<Preview>, Error> {
        Ok(Vec::new())
    }
    /// An informational message.
    fn note(&mut self, text: &str);
    /// A warning that does not stop the run.
    fn warning(&mut self, text: &str);
    /// Returns a callback for the progress of opening the dataset and measuring its statistics.
    /// Several threads call the callback with items read and total items. `Break` ends the run with
    /// [`Error::Interrupted`].
    fn reading(&self) -> Box<Reading> {
        Box::new(|_, _| ControlFlow::Continue(()))
    }
    /// True if the run should write a checkpoint and stop.
    fn stop_requested(&self) -> bool;
}

/// A picture of a sample during training.
#[derive(Clone, Debug, PartialEq)]
pub struct Preview {
    /// Name of the sample.
    pub name: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The picture as a PNG file.
    pub png: Vec<u8>,
}

/// One optimizer step.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Steps done, this one included.
    pub step: u64,
    /// Steps in total.
    pub max_steps: u64,
    /// Loss, averaged over the micro-batches by weight.
    pub loss: f64,
    /// Learning rate of the first group.
    pub learning_rate: f64,
    /// Global norm of the gradient before clipping.
    pub grad_norm: f64,
}

/// Summary of a run before its first step.
#[derive(Clone, Debug)]
pub struct RunSummary {
    /// Name of the run.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Name of the device.
    pub device: String,
    /// Its parameters.
    pub parameters: ParameterCount,
    /// Number of training items.
    pub train_phrases: usize,
    /// Number of held-out items.
    pub validation_phrases: usize,
    /// Skipped unusable items, with the reason.
    pub skipped: Vec<(String, String)>,
    /// Steps already done.
    pub step: u64,
    /// Steps in total.
    pub max_steps: u64,
}
