//! `kinegrad merge`

use std::process::ExitCode;

use kinegrad_train::Error;
use kinegrad_train::checkpoint::State;
use kinegrad_train::systems::Systems;

use super::sample::checkpoint;
use crate::args::MergeArguments;

/// Writes a run of plain weights.
pub fn run(systems: Systems<'_>, arguments: MergeArguments) -> Result<ExitCode, Error> {
    let path = checkpoint(&arguments.run)?;
    let (system, _) = systems.of(&State::read(&path)?.config)?;
    let written = system.merge(&path, &arguments.out)?;
    say!("merged {} into {}", path.display(), written.display());
    Ok(ExitCode::SUCCESS)
}
