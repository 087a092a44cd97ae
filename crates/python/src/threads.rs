//! The threads of computations, in this process and in its forks.

use std::mem;
use std::process;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// The process that imported the module.
static IMPORTED_BY: OnceLock<u32> = OnceLock::new();

/// The threads of a fork, and its process.
static OF_FORK: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Stores this process as the process that imported the module, and limits its threads.
pub fn remember_process() {
    kinegrad_cli::bound_threads();
    let _ = IMPORTED_BY.set(process::id());
}

/// Runs `work`. Threads do not survive a fork, so a forked process runs it in a separate pool.
pub fn run<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match IMPORTED_BY.get() {
        Some(process) if *process != process::id() => of_fork().install(work),
        _ => work(),
    }
}

fn of_fork() -> Arc<ThreadPool> {
    let mut pool = OF_FORK.lock().unwrap_or_else(PoisonError::into_inner);
    match &*pool {
        Some((process, pool)) if *process == process::id() => pool.clone(),
        _ => {
            let built = ThreadPoolBuilder::new().build();
            let built = Arc::new(built.expect("a process can start threads"));
            // Dropping the parent's pool would wait for threads that do not exist here.
            mem::forget(pool.replace((process::id(), built.clone())));
            built
        }
    }
}
