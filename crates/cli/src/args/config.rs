//! Arguments of the commands that help to get going.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

/// Without NAME, writes the quickstart to kinegrad.toml, which `kinegrad train` takes where no
/// config is given; others are written to NAME.toml. A file that is there is not overwritten.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad init && kinegrad train
  kinegrad init --list
  kinegrad init gmd_motion_tiny && kinegrad train gmd_motion_tiny.toml")]
pub struct InitArguments {
    /// Which config, plan or goal to write: a name that `--list` prints
    #[arg(value_name = "NAME")]
    pub name: Option<String>,
    /// File to write [default: kinegrad.toml, or NAME.toml]
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// List what can be written
    #[arg(long, conflicts_with_all = ["name", "out"])]
    pub list: bool,
}

/// Says what keys of a training config, of a plan of `kinegrad data prepare` and of a goal mean,
/// which values they may have, and their defaults. docs/config.md has all of them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad config explain optim.learning_rate
  kinegrad config explain sampling
  kinegrad config explain")]
pub struct ExplainArguments {
    /// A key, a table, or the last part of a key; without it, every key is listed in a line
    #[arg(value_name = "KEY")]
    pub key: Option<String>,
    /// Print every key as a page of Markdown
    #[arg(long, conflicts_with = "key")]
    pub markdown: bool,
}

/// Prints a script that completes commands and options in a shell.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad completions bash > ~/.local/share/bash-completion/completions/kinegrad
  kinegrad completions zsh > ~/.zfunc/_kinegrad
  kinegrad completions fish > ~/.config/fish/completions/kinegrad.fish")]
pub struct CompletionsArguments {
    /// The shell
    pub shell: Shell,
}

/// Writes kinegrad.1 and a page for each command, such as kinegrad-train.1.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad man --out ~/.local/share/man/man1 && man kinegrad-train")]
pub struct ManArguments {
    /// Folder to write them to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
