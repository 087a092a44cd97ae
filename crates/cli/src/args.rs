//! Command-line arguments, parsed with clap. The commands themselves are in `commands`.

mod config;
mod data;
#[cfg(test)]
mod documented_tests;
mod eval;
#[cfg(test)]
mod hint_tests;
mod matching;
mod reading;
mod reports;
mod sample;
mod text;
mod train;
mod values;
mod verbosity;
mod view;
mod warp;
mod weights;

use std::any::TypeId;
use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::{PathBufValueParser, StringValueParser, TypedValueParser};
use clap::{Arg, ArgAction, Command as Line, CommandFactory, FromArgMatches, Parser, Subcommand};
use kinegrad_capture::Units;

pub use self::{config::*, data::*, eval::*, matching::*, reading::*, reports::*, sample::*};
pub use self::{text::*, train::*, verbosity::*, view::*, warp::*, weights::*};

use values::number;

/// Train and fine-tune motion-generation models.
#[derive(Debug, Parser)]
#[command(
    name = "kinegrad",
    version,
    arg_required_else_help = true,
    max_term_width = 100
)]
#[command(after_help = "\
Exit codes:
  0    success
  1    a check failed, or the run failed
  2    invalid input: arguments, config, data, checkpoint, or a run that is in use
  130  interrupted by Ctrl-C, after writing a checkpoint")]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub verbosity: VerbosityArgs,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a config to start from
    Init(InitArguments),
    /// Train a model from a config file, or resume a run
    Train(TrainArguments),
    /// Generate motion with a trained model
    Sample(Box<SampleArguments>),
    /// Make new motion from examples, without training
    Match(Box<MatchArguments>),
    /// Move a motion onto a path
    Warp(WarpArguments),
    /// Convert published PyTorch weights into a run
    Import(ImportArguments),
    /// Merge the LoRA adapters of a fine-tuned model into its weights
    Merge(MergeArguments),
    /// Check motion files for physical sanity
    Check(CheckArguments),
    /// Evaluate trained models on held-out data
    Eval(EvalArguments),
    /// Plot a motion file, or the loss curves of a run
    Plot(PlotArguments),
    /// Write a page about a run
    Report(ReportArguments),
    /// List runs
    Runs(RunsArguments),
    /// Show motion in 3D, with its music
    View(ViewArguments),
    /// Create and inspect datasets
    #[command(subcommand)]
    Data(DataCommand),
    /// Extract audio features from songs
    #[command(subcommand)]
    Audio(AudioCommand),
    /// Embed texts with CLIP
    #[command(subcommand)]
    Text(TextCommand),
    /// Inspect configs
    #[command(subcommand)]
    Config(ConfigCommand),
    /// List the devices that this build supports
    Devices,
    /// Print a completion script for a shell
    Completions(CompletionsArguments),
    /// Write manual pages
    Man(ManArguments),
}

impl Arguments {
    /// Reads a command line.
    pub fn read(
        line: impl IntoIterator<Item = impl Into<OsString> + Clone>,
    ) -> Result<Self, clap::Error> {
        let mut command = with_numbers(Self::command());
        let found = command.try_get_matches_from_mut(line)?;
        Self::from_arg_matches(&found).map_err(|error| error.format(&mut command))
    }
}

/// The file name that means standard output.
pub const STDOUT: &str = "-";

/// The command with readable errors for numbers. An option that takes a number accepts `-1`. Only
/// `init` writes to standard output.
fn with_numbers(command: Line) -> Line {
    let has_stdout = command.get_name() == "init";
    let command = command.mut_args(|argument| {
        if argument.get_id() == "out" && !has_stdout {
            return with_a_file(argument);
        }
        if !matches!(argument.get_action(), ArgAction::Set | ArgAction::Append) {
            return argument;
        }
        let kind = argument.get_value_parser().type_id();
        let argument = match () {
            () if kind == TypeId::of::<usize>() => argument.value_parser(number::<usize>),
            () if kind == TypeId::of::<u64>() => argument.value_parser(number::<u64>),
            () if kind == TypeId::of::<f64>() => argument.value_parser(number::<f64>),
            () if kind == TypeId::of::<Units>() => argument,
            () => return argument,
        };
        argument.allow_negative_numbers(true)
    });
    command.mut_subcommands(with_numbers)
}

/// An output option that refuses standard output.
fn with_a_file(argument: Arg) -> Arg {
    fn a_file<T: PartialEq<str>>(out: T) -> Result<T, &'static str> {
        match out == *STDOUT {
            true => Err("this command does not write to standard output, name a file or folder"),
            false => Ok(out),
        }
    }
    match argument.get_value_parser().type_id() == TypeId::of::<String>() {
        true => argument.value_parser(StringValueParser::new().try_map(a_file)),
        false => argument.value_parser(
            PathBufValueParser::new()
                .try_map(|out: PathBuf| a_file(out.into_os_string()).map(PathBuf::from)),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_file_is_called_like_standard_output() {
        for line in [
            "kinegrad sample run --out -",
            "kinegrad warp a.npy --path p.toml --out -",
            "kinegrad data prepare p.toml --out -",
            "kinegrad report run --out -",
            "kinegrad man --out -",
        ] {
            let said = refused(line);
            assert!(said.contains("standard output"), "{said}");
        }
    }

    fn refused(line: &str) -> String {
        let line = line.split_whitespace();
        Arguments::read(line).expect_err("refused").to_string()
    }

    #[test]
    fn a_number_below_zero_is_the_value_of_its_option() {
        for line in [
            "kinegrad view a.npy --fps -1",
            "kinegrad view a.npy --audio a.mp3 --start -5",
            "kinegrad plot a.npy --out a.svg --fps -2.5",
            "kinegrad audio features a.mp3 --out a --start -5 --duration -1",
            "kinegrad sample run --out a --audio a.mp3 --start -5 --guidance-scale -1",
        ] {
            Arguments::read(line.split_whitespace()).expect(line);
        }
        for line in [
            "kinegrad sample run --out a --count -1",
            "kinegrad sample run --out a --frames -1",
            "kinegrad sample run --out a --steps 1.5",
            "kinegrad eval run --seed -1",
            "kinegrad data synth --out a --phrases -1",
            "kinegrad import a.pt --arch gmd_motion --out a --padded-frames -1",
        ] {
            let said = refused(line);
            assert!(
                said.contains("allowed: a whole number, 0 or more"),
                "{said}"
            );
        }
        let said = refused("kinegrad view a.npy --units -1");
        assert!(said.contains("a positive number of metres"), "{said}");
        let said = refused("kinegrad eval run --seed 99999999999999999999");
        assert!(said.contains("at most 18446744073709551615"), "{said}");
        let said = refused("kinegrad view a.npy -1");
        assert!(said.contains("unexpected argument"), "{said}");
    }
}
