//! `kinegrad merge`

use std::process::ExitCode;

use kinegrad_train::checkpoint::resolve_checkpoint;
use kinegrad_train::systems::cc_motion::merge;

use crate::args::MergeArguments;
use crate::failure::Failure;

/// Writes a run of plain weights.
pub fn run(arguments: MergeArguments) -> Result<ExitCode, Failure> {
    let path = resolve_checkpoint(&arguments.run, |damaged| tell!("warning: {damaged}"))?;
    let written = merge(&path, &arguments.out)?;
    say!("merged {} into {}", path.display(), written.display());
    Ok(ExitCode::SUCCESS)
}
