//! The processes that a launcher has started to train one run.

use std::env;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;

use kinegrad_ranks::{Alone, Ranks};
use kinegrad_train::Error;

use crate::output;

/// This process among those of its launcher, or alone.
///
/// # Errors
/// [`Error::Usage`] if a launcher has started several and this program cannot talk to them.
pub fn ranks() -> Result<Rc<dyn Ranks>, Error> {
    #[cfg(feature = "mpi")]
    if kinegrad_ranks::Mpi::is_launched()
        && let Some(mpi) = kinegrad_ranks::Mpi::start()
    {
        share_cores();
        if !mpi.is_first() {
            output::be_silent();
        }
        return Ok(Rc::new(mpi));
    }
    let told = ["PMI_SIZE", "OMPI_COMM_WORLD_SIZE"];
    match told.iter().find_map(|name| number(name)) {
        Some(size) if size > 1 && cfg!(not(feature = "mpi")) => Err(Error::usage(
            format!(
                "a launcher has started {size} processes, and this program knows nothing of MPI"
            ),
            "build it with `--features mpi` (docs/cluster.md), or start it without the launcher",
        )),
        _ => Ok(Rc::new(Alone)),
    }
}

fn number(name: &str) -> Option<usize> {
    env::var(name).ok()?.parse().ok()
}

/// Gives this process its part of the machine's cores, unless RAYON_NUM_THREADS says how many threads.
#[cfg(feature = "mpi")]
fn share_cores() {
    const LOCAL: [&str; 3] = [
        "MPI_LOCALNRANKS",
        "OMPI_COMM_WORLD_LOCAL_SIZE",
        "SLURM_NTASKS_PER_NODE",
    ];
    let local = LOCAL.iter().find_map(|name| number(name)).unwrap_or(1);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if env::var_os("RAYON_NUM_THREADS").is_none() && local > 1 {
        let pool = rayon::ThreadPoolBuilder::new().num_threads((cores / local).max(1));
        // Fails only if something has begun to compute already.
        let _ = pool.build_global();
    }
}

/// Does `work` with the others; a panic ends them too, which else would wait for this one.
pub fn guarded<T>(ranks: &dyn Ranks, work: impl FnOnce() -> T) -> T {
    if ranks.size() == 1 {
        return work();
    }
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| ranks.abort(101))
}

/// Whether this rank says what ended the run: the first of those that met something themselves.
pub fn speaks(ranks: &dyn Ranks, error: Option<&Error>) -> bool {
    let own = error.is_some_and(|error| !matches!(error, Error::OtherRank { .. }));
    let all = ranks.gather(&[u8::from(own)]);
    let first = all.iter().position(|said| said == &[1]);
    first == Some(ranks.rank())
}
