//! The processes that a launcher started for one run.

use std::env;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::rc::Rc;

use kinegrad_ranks::{Alone, Ranks};
use kinegrad_train::{Error, ProcessGroup};

use crate::{log, output};

/// The processes of this command. All processes but the first print only errors. Fails if a
/// launcher started several processes that this program cannot reach.
pub fn process_group() -> Result<Rc<ProcessGroup>, Error> {
    let group = ProcessGroup::new(ranks()?);
    if !group.writes() {
        output::be_silent();
        log::be_silent();
    }
    Ok(group)
}

/// The outcome of a command on several processes. If a process failed, it prints its error, and all
/// processes get its exit code. Collective. A single process gets the error of `outcome`.
pub fn agreed<T>(
    group: &ProcessGroup,
    outcome: Result<T, Error>,
) -> Result<Result<T, ExitCode>, Error> {
    let ranks = group.ranks();
    if ranks.size() == 1 {
        return outcome.map(Ok);
    }
    let Some((rank, code)) = group.first_failure(outcome.as_ref().err()) else {
        return outcome.map(Ok);
    };
    if let Err(error) = &outcome
        && rank == ranks.rank()
    {
        output::failure(error);
    }
    group.barrier();
    Ok(Err(ExitCode::from(code)))
}

/// The ranks of the launcher, or this process alone.
fn ranks() -> Result<Rc<dyn Ranks>, Error> {
    let (ranks, launched) = (started(), launched());
    let size = ranks.size();
    if launched == 1 || launched == size {
        return Ok(ranks);
    }
    let (what, hint) = match cfg!(feature = "mpi") {
        false => (
            "was built without MPI".to_string(),
            "build it with `--features mpi` (docs/cluster.md), or start it without the launcher",
        ),
        true => (
            format!("finds {size} of them through MPI"),
            "start it with the launcher of the MPI that it was built with; with SLURM, \
             `srun --mpi=pmi2` or `--mpi=pmix` (docs/cluster.md)",
        ),
    };
    let message = format!("a launcher has started {launched} processes, and this program {what}");
    Err(Error::usage(message, hint))
}

/// Prints an error once for all processes, and returns the exit code.
pub fn failed(error: Error) -> ExitCode {
    if are_several()
        && let Ok(group) = process_group()
        && group.ranks().size() > 1
    {
        // Other processes may be running.
        let outcome: Result<(), Error> = group.report_failure(Err(error));
        return match agreed(&group, outcome) {
            Ok(Err(code)) => code,
            _ => unreachable!("one of several processes has failed"),
        };
    }
    output::failure(&error);
    ExitCode::from(error.exit_code())
}

/// True if a launcher started several processes.
pub fn are_several() -> bool {
    launched() > 1
}

/// The launcher's number of processes; 1 without a launcher.
fn launched() -> usize {
    let number = |name: &str| env::var(name).ok()?.parse().ok();
    let names = ["PMI_SIZE", "OMPI_COMM_WORLD_SIZE"];
    let by_slurm = || env::var_os("SLURM_PROCID").and_then(|_| number("SLURM_STEP_NUM_TASKS"));
    let processes: Option<usize> = names.into_iter().find_map(number).or_else(by_slurm);
    processes.unwrap_or(1).max(1)
}

/// Rejects several processes.
pub fn must_be_one() -> Result<(), Error> {
    match launched() {
        1 => Ok(()),
        processes => Err(Error::usage(
            format!("a launcher has started {processes} processes, and each would do the same"),
            "processes share `kinegrad train` and `kinegrad eval`: start other commands without the launcher",
        )),
    }
}

fn started() -> Rc<dyn Ranks> {
    #[cfg(feature = "mpi")]
    if kinegrad_ranks::Mpi::is_launched()
        && let Some(mpi) = kinegrad_ranks::Mpi::start()
    {
        share_cores(mpi.local().sharing);
        return Rc::new(mpi);
    }
    Rc::new(Alone)
}

/// Divides the cores among the processes that share them, unless RAYON_NUM_THREADS is set.
#[cfg(feature = "mpi")]
fn share_cores(processes: usize) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if env::var_os("RAYON_NUM_THREADS").is_none() && processes > 1 {
        let pool = rayon::ThreadPoolBuilder::new().num_threads((cores / processes).max(1));
        // Fails only if the pool is in use.
        let _ = pool.build_global();
    }
}

/// Runs `work`. A panic ends all processes, because the others would wait for this process.
pub fn guarded<T>(ranks: &dyn Ranks, work: impl FnOnce() -> T) -> T {
    if ranks.size() == 1 {
        return work();
    }
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| ranks.abort(101))
}
