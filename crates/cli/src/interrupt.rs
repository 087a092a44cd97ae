//! Ctrl-C while samples are drawn: the process ends at once, but never while a sample is written.

use std::sync::{Mutex, PoisonError};

/// Held while the files of a sample are written.
static WRITING: Mutex<()> = Mutex::new(());

/// Ends the process with exit code 130 on Ctrl-C, after the sample that is being written.
pub fn end_between_samples() {
    let handler = || {
        let _whole = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        tell!("\ninterrupted");
        std::process::exit(130);
    };
    // Fails only if a handler is set already; then that one decides.
    let _ = ctrlc::set_handler(handler);
}

/// Does what must not be interrupted.
pub fn not_during<T>(work: impl FnOnce() -> T) -> T {
    let _whole = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    work()
}
