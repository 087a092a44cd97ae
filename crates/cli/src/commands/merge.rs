//! `kinegrad merge`

use std::process::ExitCode;

use kinegrad_train::{Error, Systems};

use super::sample::checkpoint;
use crate::args::MergeArguments;

/// Writes a run of plain weights.
pub fn run(systems: Systems<'_>, arguments: MergeArguments) -> Result<ExitCode, Error> {
    let saved = checkpoint(&arguments.run)?;
    let (system, _) = systems.of(&saved.state.config)?;
    let path = saved.path.clone();
    let written = system.merge(saved, &arguments.out)?;
    say!("merged {} into {}", path.display(), written.display());
    Ok(ExitCode::SUCCESS)
}
