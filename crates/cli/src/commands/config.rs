//! `kinegrad config`

use std::process::ExitCode;

use kinegrad_train::config::EnvironmentSetting;
use kinegrad_train::config::environment::runs_dir;
use kinegrad_train::{Error, Systems, memory, run};

use crate::args::ShowArguments;
use crate::output;

/// Prints the resolved config, with comments on the size of the model and on the origin of each value.
pub fn show(systems: Systems<'_>, arguments: ShowArguments) -> Result<ExitCode, Error> {
    let ShowArguments { config, overrides } = arguments;
    let environment = EnvironmentSetting::all()?;
    let mut warn = |missing: &Error| {
        tell!("warning: {missing}; its networks and process are not shown");
    };
    let (config, origins) =
        run::load_config(systems, &config, &overrides, &environment, &mut warn)?;
    for warning in systems.validate(&config)? {
        tell!("warning: {warning}");
    }
    let (system, _) = systems.of(&config)?;
    let parameters = output::parameters(&system.parameters(&config)?);
    say!("# model: {parameters}");
    let needed = system.footprint(&config)?.of_training(&config, true);
    let needed = memory::size(needed);
    say!("# memory: about {needed} to train it on the CPU");
    let (folder, origin) = runs_dir()?;
    say!("# runs folder: {}  # {origin}", folder.display());
    show!("{}", origins.annotated(&config).trim_end());
    Ok(ExitCode::SUCCESS)
}
