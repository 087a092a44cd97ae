//! Ctrl-C: the process ends at once, but not while a file is written.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Locked while files are written; true while the running work checks [`STOP`].
static WRITING: Mutex<bool> = Mutex::new(false);

/// A stop was requested.
static STOP: AtomicBool = AtomicBool::new(false);

/// Makes Ctrl-C stop [`stoppable`] work, or end the process with exit code 130 once no file is
/// being written.
pub fn end_between_files() {
    let handler = || {
        let stoppable = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        if *stoppable {
            STOP.store(true, Ordering::SeqCst);
            return;
        }
        tell!("\ninterrupted");
        std::process::exit(130);
    };
    // Fails only if a handler is set already.
    let _ = ctrlc::set_handler(handler);
}

/// Runs `work` without interruption.
pub fn not_during<T>(work: impl FnOnce() -> T) -> T {
    let _whole = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    work()
}

/// Runs long work. The work stops and cleans up soon after its argument returns true.
pub fn stoppable<T>(work: impl FnOnce(&dyn Fn() -> bool) -> T) -> T {
    let set = |on| *WRITING.lock().unwrap_or_else(PoisonError::into_inner) = on;
    set(true);
    let done = work(&|| STOP.load(Ordering::SeqCst));
    set(false);
    done
}
