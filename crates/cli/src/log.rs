//! Log lines of `--verbose` and RUST_LOG.

use std::io::Write as _;

use kinegrad_output::message;

use crate::args::VerbosityArgs;
use crate::output;

/// Environment variable with levels by module, such as `kinegrad_train=debug`.
const VARIABLE: &str = "RUST_LOG";

/// Logs only errors from now on: another process prints the rest.
pub fn be_silent() {
    ::log::set_max_level(::log::LevelFilter::Error);
}

/// Starts logging to standard error.
pub fn start(verbosity: VerbosityArgs) {
    if verbosity.quiet {
        output::be_quiet();
    }
    let default = match verbosity.verbose {
        true => "kinegrad=debug,kinegrad_train=debug,kinegrad_data=debug,kinegrad_cli=debug",
        false => "off",
    };
    let environment = env_logger::Env::default().filter_or(VARIABLE, default);
    // Fails only if a logger is set already.
    let _ = env_logger::Builder::from_env(environment)
        .format(|out, record| {
            let level = record.level().as_str().to_lowercase();
            writeln!(out, "{level}: {}", message(&record.args().to_string()))
        })
        .try_init();
}
