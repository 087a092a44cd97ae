//! The `kinegrad` command line, for any list of systems.
//!
//! All commands also work for the systems of another program:
//!
//! ```no_run
//! use kinegrad_systems::BUILT_IN;
//! use kinegrad_train::{System, Systems};
//!
//! fn with(mine: &dyn System) -> std::process::ExitCode {
//!     let all: Vec<&dyn System> = BUILT_IN.0.iter().copied().chain([mine]).collect();
//!     kinegrad_cli::run(Systems(&all), std::env::args_os())
//! }
//! ```
#![recursion_limit = "256"]
// `say!` and `tell!` replace `println!` and `eprintln!`, which panic on a closed pipe.
#![warn(clippy::print_stdout, clippy::print_stderr)]
// An error moves once, at the end of a command, so the size of errors does not matter.
#![allow(clippy::result_large_err)]

#[macro_use]
mod output;

mod args;
mod commands;
mod conditions;
mod folder;
mod interrupt;
mod io;
mod log;
mod options;
mod preview;
mod progress;
mod ranks;
mod runs;
mod scene;
mod threads;
mod train_progress;

pub use commands::sample::{checkpoint, while_it_is_trained};
pub use commands::train::sample_at_end;
pub use conditions::ConditionArguments;
pub use io::{Files, bvh_text, must_be_finite};
pub use options::as_arguments;
pub use output::unusable;
pub use threads::bound as bound_threads;

use std::ffi::OsString;
use std::process::ExitCode;

use kinegrad_output::{MOST, block};
use kinegrad_train::{Error, Systems};

use args::{Arguments, AudioCommand, Command, ConfigCommand, DataCommand, TextCommand};

/// Parses and runs a command line with `systems`, and returns the exit code.
pub fn run(
    systems: Systems<'_>,
    arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>,
) -> ExitCode {
    kinegrad_kernels::memory::keep_freed();
    threads::bound();
    let done = match Arguments::read(arguments) {
        Ok(arguments) => {
            log::start(arguments.verbosity);
            execute(systems, arguments.command)
        }
        Err(error) => Err(unread(error)),
    };
    done.unwrap_or_else(ranks::failed)
}

/// The error of an invalid command line. A single process prints the error and exits here, as after
/// `--help`; one of several processes prints the returned error.
fn unread(error: clap::Error) -> Error {
    let text = error.render().to_string();
    // An argument may contain control characters, or many others.
    let is_plain = !error.use_stderr() || (block(&text) == text && text.len() < MOST);
    if is_plain && !ranks::are_several() {
        error.exit();
    }
    let message = text.trim_start_matches("error: ").split("\n\n").next();
    let message = message.unwrap_or_default().trim_end();
    Error::usage(message, "`kinegrad help` lists commands and options")
}

fn execute(systems: Systems<'_>, command: Command) -> Result<ExitCode, Error> {
    if !matches!(command, Command::Train(_) | Command::Eval(_)) {
        ranks::must_be_one()?;
    }
    match command {
        Command::Train(arguments) => commands::train::run(systems, arguments),
        Command::Sample(arguments) => commands::sample::run(systems, *arguments),
        Command::Match(arguments) => commands::matching::run(systems, *arguments),
        Command::Warp(arguments) => commands::warp::run(systems, arguments),
        Command::Import(arguments) => commands::import::run(systems, arguments),
        Command::Merge(arguments) => commands::merge::run(systems, arguments),
        Command::Check(arguments) => commands::check::run(systems, arguments),
        Command::Eval(arguments) => commands::eval::run(systems, arguments),
        Command::Plot(arguments) => commands::plot::run(systems, arguments),
        Command::Report(arguments) => commands::report::run(systems, arguments),
        Command::Runs(arguments) => commands::runs::run(systems, arguments),
        Command::View(arguments) => commands::view::run(systems, arguments),
        Command::Data(DataCommand::Synth(arguments)) => commands::data::synth(arguments),
        Command::Data(DataCommand::Prepare(arguments)) => commands::prepare::run(arguments),
        Command::Data(DataCommand::Inspect(arguments)) => commands::data::inspect(arguments),
        Command::Audio(AudioCommand::Features(arguments)) => commands::audio::features(arguments),
        Command::Text(TextCommand::Embed(arguments)) => commands::text::embed(arguments),
        Command::Config(ConfigCommand::Show(arguments)) => {
            commands::config::show(systems, arguments)
        }
        Command::Config(ConfigCommand::Explain(arguments)) => {
            commands::explain::run(systems, arguments)
        }
        Command::Devices => commands::devices::run(),
        Command::Init(arguments) => commands::init::run(arguments),
        Command::Completions(arguments) => commands::shell::completions(arguments),
        Command::Man(arguments) => commands::shell::man(arguments),
    }
}
