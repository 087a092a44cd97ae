//! Ctrl-C while files are made: the process ends at once, but never while a file is written.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Held while files are written; whether what is under way looks at [`STOP`].
static WRITING: Mutex<bool> = Mutex::new(false);

/// Whether what is under way should stop.
static STOP: AtomicBool = AtomicBool::new(false);

/// Ends the process with exit code 130 on Ctrl-C, after the files that are being written, or asks
/// what is [`stoppable`] to stop.
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
    // Fails only if a handler is set already; then that one decides.
    let _ = ctrlc::set_handler(handler);
}

/// Does what must not be interrupted.
pub fn not_during<T>(work: impl FnOnce() -> T) -> T {
    let _whole = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    work()
}

/// Does what takes long and may leave something behind: it ends soon after what it is given says
/// so, and clears up.
pub fn stoppable<T>(work: impl FnOnce(&dyn Fn() -> bool) -> T) -> T {
    let set = |on| *WRITING.lock().unwrap_or_else(PoisonError::into_inner) = on;
    set(true);
    let done = work(&|| STOP.load(Ordering::SeqCst));
    set(false);
    done
}
