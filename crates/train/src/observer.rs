//! What a training tells, and asks, whoever started it.

use std::path::{Path, PathBuf};

/// What the trainer tells, and asks, whoever started it.
pub trait Observer {
    /// The run was set up and trains from now on (or was finished before).
    fn started(&mut self, summary: &RunSummary);
    /// A step was done.
    fn stepped(&mut self, report: &StepReport);
    /// The held-out phrases were measured; `best` if no earlier loss was lower.
    fn validated(&mut self, step: u64, val_loss: f64, best: bool);
    /// A checkpoint was written.
    fn saved(&mut self, path: &Path);
    /// Something the user should know of.
    fn note(&mut self, text: &str);
    /// Something is doubtful and does not stop the run.
    fn warning(&mut self, text: &str);
    /// What is told how many of how many phrases have been read while the dataset is opened; called
    /// from several threads.
    fn reading(&self) -> Box<dyn Fn(usize, usize) + Sync> {
        Box::new(|_, _| {})
    }
    /// Whether the user wants the run to stop; it then writes a checkpoint.
    fn stop_requested(&self) -> bool;
}

/// One optimiser step.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Steps done, this one included.
    pub step: u64,
    /// Steps in all.
    pub max_steps: u64,
    /// Loss, averaged over the micro-batches.
    pub loss: f64,
    /// Learning rate of the first group.
    pub learning_rate: f64,
    /// Global norm of the gradient before clipping.
    pub grad_norm: f64,
}

/// What a run is about, told before its first step.
#[derive(Clone, Debug)]
pub struct RunSummary {
    /// Name of the run.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Name of the device.
    pub device: String,
    /// Number of parameters.
    pub parameters: usize,
    /// Phrases trained on.
    pub train_phrases: usize,
    /// Phrases held out.
    pub validation_phrases: usize,
    /// Phrases left out as unusable, with the reason.
    pub skipped: Vec<(String, String)>,
    /// Steps done before.
    pub step: u64,
    /// Steps in all.
    pub max_steps: u64,
}
