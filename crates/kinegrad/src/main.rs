//! `kinegrad`: train and fine-tune motion-generation models.

use std::process::ExitCode;

use kinegrad_systems::BUILT_IN;

fn main() -> ExitCode {
    kinegrad_cli::run(BUILT_IN, std::env::args_os())
}
