//! `kinegrad import`

use std::process::ExitCode;

use kinegrad_report::grouped;
use kinegrad_settings::counted;
use kinegrad_train::import::ImportRequest;
use kinegrad_train::{Error, Systems};

use crate::args::ImportArguments;

/// Writes a run of published weights.
pub fn run(systems: Systems<'_>, arguments: ImportArguments) -> Result<ExitCode, Error> {
    let name = &arguments.arch;
    let all = || systems.0.iter();
    let Some(system) = all().find(|system| system.architectures().contains(&name.as_str())) else {
        let known: Vec<&str> = all().flat_map(|s| s.architectures()).copied().collect();
        let message = format!("weights of `--arch {name}` cannot be imported");
        let hint = format!("supported architectures: {}", known.join(", "));
        return Err(Error::usage(message, hint));
    };
    let imported = system.import(&ImportRequest {
        weights: arguments.weights.clone(),
        architecture: arguments.arch,
        mean: arguments.mean,
        std: arguments.std,
        projection: arguments.projection,
        padded_frames: arguments.padded_frames,
        last: arguments.last,
        overrides: arguments.overrides,
        out: arguments.out,
    })?;
    for warning in &imported.warnings {
        tell!("warning: {warning}");
    }
    let part = match imported.part {
        Some(part) => format!("`{part}` of {}", arguments.weights.display()),
        None => arguments.weights.display().to_string(),
    };
    say!(
        "imported {part}: {} parameters to {} ({} of other parts ignored)",
        grouped(imported.parameters),
        imported.path.display(),
        counted(imported.skipped, "tensor")
    );
    Ok(ExitCode::SUCCESS)
}
