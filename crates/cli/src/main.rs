//! `kinegrad`: train and fine-tune motion-generation models.
#![recursion_limit = "256"]
// `say!` and `tell!` stand for them, which survive a reader that has gone.
#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
mod output;

mod args;
mod commands;
mod comparison;
mod failure;
mod picture;
mod progress;

use std::process::ExitCode;

use clap::Parser;

use args::{Arguments, AudioCommand, Command, ConfigCommand, DataCommand};
use failure::Failure;

fn main() -> ExitCode {
    kinegrad_kernels::memory::keep_freed();
    let arguments = Arguments::parse();
    match run(arguments.command) {
        Ok(code) => code,
        Err(failure) => {
            tell!("{failure}");
            ExitCode::from(failure.exit_code)
        }
    }
}

fn run(command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Train(arguments) => commands::train::run(arguments),
        Command::Sample(arguments) => commands::sample::run(arguments),
        Command::Import(arguments) => commands::import::run(arguments),
        Command::Merge(arguments) => commands::merge::run(arguments),
        Command::Check(arguments) => commands::check::run(arguments),
        Command::Eval(arguments) => commands::eval::run(arguments),
        Command::Plot(arguments) => commands::plot::run(arguments),
        Command::Data(DataCommand::Synth(arguments)) => commands::data::synth(arguments),
        Command::Data(DataCommand::Prepare(arguments)) => commands::prepare::run(arguments),
        Command::Data(DataCommand::Inspect(arguments)) => commands::data::inspect(arguments),
        Command::Audio(AudioCommand::Features(arguments)) => commands::audio::features(arguments),
        Command::Config(ConfigCommand::Show(arguments)) => commands::config::show(arguments),
        Command::Devices => commands::devices::run(),
    }
}
