//! `kinegrad import`

use std::process::ExitCode;

use kinegrad_train::systems::gmd::{Architecture, ImportRequest, import};

use crate::args::{ArchitectureName, ImportArguments};
use crate::failure::{Failure, UsageError};
use crate::output::grouped;

/// Writes a run of published weights.
pub fn run(arguments: ImportArguments) -> Result<ExitCode, Failure> {
    let (Some(mean), Some(std)) = (arguments.mean, arguments.std) else {
        let message = "published weights without the statistics of their training data";
        let hint = "give `--mean M.npy --std S.npy`, those that the model was trained with: for \
                    an absolute root Mean_abs_3d.npy and Std_abs_3d.npy";
        return Err(UsageError::new(message, hint).into());
    };
    let motion = matches!(arguments.arch, ArchitectureName::GmdMotion);
    match (motion, &arguments.projection) {
        (true, None) => tell!(
            "warning: no `--projection`: published motion models work in a projected space, and \
             draw nonsense outside of it"
        ),
        (false, Some(_)) => {
            let message = "`--projection` with `--arch gmd_trajectory`";
            let hint = "trajectory models work on features as they are";
            return Err(UsageError::new(message, hint).into());
        }
        _ => {}
    }
    let imported = import(&ImportRequest {
        weights: arguments.weights.clone(),
        architecture: match arguments.arch {
            ArchitectureName::GmdMotion => Architecture::GmdMotion,
            ArchitectureName::GmdTrajectory => Architecture::GmdTrajectory,
        },
        mean,
        std,
        projection: arguments.projection,
        padded_frames: arguments.padded_frames,
        last: arguments.last,
        out: arguments.out,
    })?;
    let part = match imported.part {
        Some(part) => format!("`{part}` of {}", arguments.weights.display()),
        None => arguments.weights.display().to_string(),
    };
    say!(
        "imported {part}: {} parameters into {} ({} tensors of other parts passed over)",
        grouped(imported.parameters),
        imported.path.display(),
        imported.skipped
    );
    Ok(ExitCode::SUCCESS)
}
