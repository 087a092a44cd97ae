//! `kinegrad config`

use std::process::ExitCode;

use kinegrad_train::{Error, Systems, config, memory, run};

use crate::args::ShowArguments;
use crate::output;

/// Prints the resolved config, with comments on the size of the model.
pub fn show(systems: Systems<'_>, arguments: ShowArguments) -> Result<ExitCode, Error> {
    let ShowArguments { config, overrides } = arguments;
    let config = run::load_config(systems, &config, &overrides, &mut |missing| {
        tell!("warning: {missing}; its networks and process are not shown");
    })?;
    for warning in systems.validate(&config)? {
        tell!("warning: {warning}");
    }
    let (system, _) = systems.of(&config)?;
    let parameters = output::parameters(&system.parameters(&config)?);
    say!("# model: {parameters}");
    let needed = system.footprint(&config)?.of_training(&config, true);
    let needed = memory::size(needed);
    say!("# memory: about {needed} to train it on the CPU");
    show!("{}", config::to_toml(&config).trim_end());
    Ok(ExitCode::SUCCESS)
}
