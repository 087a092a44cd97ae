//! Progress: a bar on a terminal, lines elsewhere.

use std::fmt;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use kinegrad_output::cell;
use kinegrad_report::grouped;
use kinegrad_train::Reading;

use crate::output;

/// Time between lines of a count without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(20);

/// Seconds as `1h02m`, `3m20s` or `5s`.
pub fn duration(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s}s"),
        (0, m, s) => format!("{m}m{s:02}s"),
        (h, m, _) => format!("{h}h{m:02}m"),
    }
}

/// Elapsed time and time left, both as [`duration`].
pub fn times(elapsed: Duration, left: Duration) -> String {
    let [elapsed, left] = [elapsed, left].map(|time| duration(time.as_secs_f64()));
    format!("{elapsed}, {left} left")
}

/// A flag that Ctrl-C sets. The first Ctrl-C while `is_active` is set prints `message`; any other
/// Ctrl-C ends the process.
pub fn stop_on_ctrl_c(message: &'static str, is_active: Arc<AtomicBool>) -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::SeqCst) || !is_active.load(Ordering::SeqCst) {
            std::process::exit(130);
        }
        tell!("\n{message}; again to stop at once");
    };
    // Fails only if a handler is set already.
    let _ = ctrlc::set_handler(handler);
    stop
}

/// A count: a bar on a terminal, a line every 20 seconds elsewhere.
pub struct Count {
    bar: ProgressBar,
    what: &'static str,
    /// Time of the last line.
    printed: Mutex<Instant>,
}

impl Count {
    /// Shows nothing yet.
    pub fn new(what: &'static str) -> Self {
        Self {
            bar: bar(&format!("{{bar:24}} {{pos}}/{{len}} {what}  {{times}}")),
            what,
            printed: Mutex::new(Instant::now()),
        }
    }

    /// Shows `done` of `total`.
    pub fn show(&self, done: usize, total: usize) {
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
        if done == total {
            self.bar.finish_and_clear();
        } else if self.bar.is_hidden()
            && let Ok(mut printed) = self.printed.try_lock()
            && printed.elapsed() >= LINE_INTERVAL
        {
            *printed = Instant::now();
            tell!("{} of {} {}", grouped(done), grouped(total), self.what);
        }
    }
}

/// Shows the number of items read, until `stop` is set.
pub fn reading(stop: Arc<AtomicBool>) -> Box<Reading> {
    let count = Count::new("phrases read");
    Box::new(move |read, total| {
        count.show(read, total);
        match stop.load(Ordering::SeqCst) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    })
}

/// A bar of denoising steps, if standard error is a terminal.
pub struct Denoising(ProgressBar);

impl Denoising {
    /// Shows nothing yet; `run` is printed before the bar.
    pub fn of(run: &str) -> Self {
        let template = "{prefix}{msg}{bar:24} {pos}/{len} denoising steps  {times}";
        Self(bar(template).with_prefix(spaced(run)))
    }

    /// Shows `done` of `all` steps of a stage.
    pub fn show(&self, stage: &str, done: usize, all: usize) {
        self.0.set_message(spaced(stage));
        self.0.set_length(all as u64);
        self.0.set_position(done as u64);
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.0.finish_and_clear();
    }
}

/// A word and two spaces, or nothing.
fn spaced(word: &str) -> String {
    let end = if word.is_empty() { "" } else { "  " };
    format!("{}{end}", cell(word))
}

/// A bar on standard error, hidden if standard error is not a terminal. `{times}` in the template
/// are elapsed time and time left.
pub fn bar(template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).expect("a valid template");
    let style = style.with_key(
        "times",
        |state: &ProgressState, text: &mut dyn fmt::Write| {
            let _ = text.write_str(&times(state.elapsed(), state.eta()));
        },
    );
    let target = match output::is_quiet() {
        true => ProgressDrawTarget::hidden(),
        false => ProgressDrawTarget::stderr(),
    };
    ProgressBar::with_draw_target(None, target).with_style(style)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_times_have_one_unit_style() {
        let [elapsed, left] = [100.0, 88.0].map(Duration::from_secs_f64);
        assert_eq!(times(elapsed, left), "1m40s, 1m28s left");
    }
}
