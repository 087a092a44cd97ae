//! Progress: a bar on a terminal, lines elsewhere.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use kinegrad_report::grouped;
use kinegrad_train::Reading;

use crate::output;

/// Time between lines of a count where there is no terminal.
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

/// A flag that Ctrl-C sets, saying `message`, once something is `under_way`; a second Ctrl-C, or
/// one before, ends the process.
pub fn stop_on_ctrl_c(message: &'static str, under_way: Arc<AtomicBool>) -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::SeqCst) || !under_way.load(Ordering::SeqCst) {
            std::process::exit(130);
        }
        tell!("\n{message}; again to stop at once");
    };
    // Fails only if a handler is set already; then that one decides.
    let _ = ctrlc::set_handler(handler);
    stop
}

/// Counts things done: a bar on a terminal, a line now and then elsewhere.
pub struct Count {
    bar: ProgressBar,
    what: &'static str,
    /// When the last line was written.
    told: Mutex<Instant>,
}

impl Count {
    /// Shows nothing yet.
    pub fn new(what: &'static str) -> Self {
        let template = format!("{{bar:24}} {{pos}}/{{len}} {what}  {{elapsed}}<{{eta}}");
        Self {
            bar: bar(&template),
            what,
            told: Mutex::new(Instant::now()),
        }
    }

    /// So many of so many are done.
    pub fn show(&self, done: usize, total: usize) {
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
        if done == total {
            self.bar.finish_and_clear();
        } else if self.bar.is_hidden()
            && let Ok(mut told) = self.told.try_lock()
            && told.elapsed() >= LINE_INTERVAL
        {
            *told = Instant::now();
            tell!("{} of {} {}", grouped(done), grouped(total), self.what);
        }
    }
}

/// What shows how many phrases or clips of a dataset have been read, until a `stop` is asked for.
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

/// A bar for the drawing of samples. Shows nothing where standard error is no terminal.
pub struct Denoising(ProgressBar);

impl Denoising {
    /// Shows nothing yet; `run` stands before the bar, where several are drawn from.
    pub fn of(run: &str) -> Self {
        let template = "{prefix}{msg}{bar:24} {pos}/{len} denoising steps  {elapsed}<{eta}";
        Self(bar(template).with_prefix(spaced(run)))
    }

    /// So many of so many steps are done, of a stage if there are several.
    pub fn show(&self, stage: &str, done: usize, all: usize) {
        self.0.set_message(spaced(stage));
        self.0.set_length(all as u64);
        self.0.set_position(done as u64);
    }

    /// Takes the bar away.
    pub fn finish(self) {
        self.0.finish_and_clear();
    }
}

/// A word with room behind it, or nothing.
fn spaced(word: &str) -> String {
    if word.is_empty() {
        String::new()
    } else {
        format!("{word}  ")
    }
}

/// A bar on standard error, if that is a terminal.
pub fn bar(template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).expect("a valid template");
    let target = match output::is_quiet() {
        true => ProgressDrawTarget::hidden(),
        false => ProgressDrawTarget::stderr(),
    };
    ProgressBar::with_draw_target(None, target).with_style(style)
}
