//! Progress of a training run.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use kinegrad_settings::counted;
use kinegrad_train::{Error, Observer, Preview, Reading, RunSummary, StepReport, Systems};

use crate::progress::{bar, reading, stop_on_ctrl_c, times};
use crate::{output, preview};

/// Weight of the old value in the smoothed loss.
const SMOOTHING: f64 = 0.98;

/// Number of progress lines of a training run without a terminal.
const LINES: u64 = 20;

/// Shows a training on standard error.
pub struct TrainProgress<'a> {
    systems: Systems<'a>,
    /// Hidden if standard error is not a terminal.
    bar: ProgressBar,
    smoothed: Option<f64>,
    started: Instant,
    steps_here: u64,
    stop: Arc<AtomicBool>,
    /// True if a checkpoint would save new progress.
    trains: Arc<AtomicBool>,
}

impl<'a> TrainProgress<'a> {
    /// Shows nothing yet. Ctrl-C ends the process; during training, the first Ctrl-C requests a
    /// stop.
    pub fn new(systems: Systems<'a>) -> Self {
        let trains = Arc::new(AtomicBool::new(false));
        let message = "stopping after this step and writing a checkpoint";
        let stop = stop_on_ctrl_c(message, trains.clone());
        Self {
            systems,
            trains,
            bar: ProgressBar::hidden(),
            smoothed: None,
            started: Instant::now(),
            steps_here: 0,
            stop,
        }
    }

    /// Prints a line above the bar.
    pub fn line(&self, text: &str) {
        self.bar.suspend(|| tell!("{text}"));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// Makes Ctrl-C end the process from now on. Returns true if a stop was requested before.
    pub fn end_training(&self) -> bool {
        self.trains.store(false, Ordering::SeqCst);
        self.stop_requested()
    }
}

impl Observer for TrainProgress<'_> {
    fn started(&mut self, summary: &RunSummary) {
        self.trains.store(true, Ordering::SeqCst);
        tell!(
            "run {}: {} on {}, {} to train on, {} held out",
            summary.name,
            output::parameters(&summary.parameters),
            summary.device,
            counted(summary.train_phrases, "item"),
            summary.validation_phrases,
        );
        if !summary.skipped.is_empty() {
            tell!(
                "warning: {} skipped:",
                counted(summary.skipped.len(), "bad item")
            );
            for (id, reason) in &summary.skipped {
                tell!("  {id}: {reason}");
            }
        }
        if summary.step > 0 {
            let RunSummary {
                step, max_steps, ..
            } = summary;
            tell!("continuing after step {step} of {max_steps}");
        }
        self.started = Instant::now();
        (self.smoothed, self.steps_here) = (None, 0);
        self.finish();
        let template = "{bar:24} {pos}/{len} steps  {msg}  {times}";
        self.bar = bar(template).with_position(summary.step);
        self.bar.set_length(summary.max_steps);
        self.bar.reset_eta();
    }

    fn stepped(&mut self, report: &StepReport) {
        let old = self.smoothed.unwrap_or(report.loss);
        let smoothed = SMOOTHING * old + (1.0 - SMOOTHING) * report.loss;
        self.smoothed = Some(smoothed);
        self.steps_here += 1;
        let seconds = self.started.elapsed().as_secs_f64();
        let speed = self.steps_here as f64 / seconds;
        let message = format!(
            "loss {:.4} (smoothed {smoothed:.4})  lr {:.2e}  {speed:.2} it/s",
            report.loss, report.learning_rate
        );
        let (step, max) = (report.step, report.max_steps);
        let every = (max / LINES).max(1);
        if !self.bar.is_hidden() {
            self.bar.set_position(step);
            self.bar.set_message(message);
        } else if step.is_multiple_of(every) || step == max {
            let left = Duration::from_secs_f64((max - step) as f64 / speed);
            tell!(
                "step {step}/{max}  {message}  {}",
                times(self.started.elapsed(), left)
            );
        }
    }

    fn validated(&mut self, step: u64, val_loss: f64, best: bool) {
        let mark = if best { "  best so far" } else { "" };
        self.line(&format!("step {step}  val_loss {val_loss:.5}{mark}"));
    }

    fn saved(&mut self, path: &Path) {
        self.line(&format!("saved {}", path.display()));
    }

    fn preview(&mut self, checkpoint: &Path, step: u64) -> Result<Vec<Preview>, Error> {
        let previews = preview::write(self.systems, checkpoint, step)?;
        self.line(&format!("sampled {}", counted(previews.len(), "preview")));
        Ok(previews)
    }

    fn note(&mut self, text: &str) {
        self.line(text);
    }

    fn warning(&mut self, text: &str) {
        self.line(&format!("warning: {text}"));
    }

    fn reading(&self) -> Box<Reading> {
        reading(self.stop.clone())
    }

    fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}
