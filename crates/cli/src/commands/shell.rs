//! `kinegrad completions` and `kinegrad man`

use std::process::ExitCode;

use clap::CommandFactory;
use kinegrad_output::UnfinishedFolder;
use kinegrad_train::Error;

use crate::args::{Arguments, CompletionsArguments, ManArguments};
use crate::folder;

/// The program, as shells know it.
const PROGRAM: &str = "kinegrad";

/// Prints a completion script.
pub fn completions(arguments: CompletionsArguments) -> Result<ExitCode, Error> {
    let mut script = Vec::new();
    clap_complete::generate(
        arguments.shell,
        &mut Arguments::command(),
        PROGRAM,
        &mut script,
    );
    show!("{}", String::from_utf8_lossy(&script).trim_end());
    Ok(ExitCode::SUCCESS)
}

/// Writes the manual pages.
pub fn man(arguments: ManArguments) -> Result<ExitCode, Error> {
    let out = arguments.out;
    folder::make(&out)?;
    let written = UnfinishedFolder::within(&out).and_then(|pages| {
        clap_mangen::generate_to(Arguments::command(), pages.path())?;
        pages.move_into(&out)
    });
    written.map_err(Error::io("write", &out))?;
    say!("{}", out.join(format!("{PROGRAM}.1")).display());
    Ok(ExitCode::SUCCESS)
}
