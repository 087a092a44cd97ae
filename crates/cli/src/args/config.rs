//! Arguments of `init`, `config`, `completions` and `man`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use clap_complete::Shell;

/// Arguments of `kinegrad init`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad init && kinegrad train
  kinegrad init --list
  kinegrad init gmd_motion_tiny && kinegrad train gmd_motion_tiny.toml")]
pub struct InitArguments {
    /// Config, plan or goal to write: a name that `--list` prints
    #[arg(value_name = "NAME")]
    pub name: Option<String>,
    /// File to write, `-` for standard output [default: kinegrad.toml, or NAME.toml]
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// List the names
    #[arg(long, conflicts_with_all = ["name", "out"])]
    pub list: bool,
}

#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Print a config with all defaults filled in, and the number of model parameters
    Show(ShowArguments),
    /// Explain config keys: meaning, allowed values, default
    Explain(ExplainArguments),
}

/// Arguments of `kinegrad config show`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad config show kinegrad.toml --set model.size=base")]
pub struct ShowArguments {
    /// Config file
    pub config: PathBuf,
    /// Override a key of the config
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

/// Arguments of `kinegrad config explain`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad config explain optim.learning_rate
  kinegrad config explain sampling
  kinegrad config explain")]
pub struct ExplainArguments {
    /// A key, a table, or the last part of a key [default: list all keys]
    #[arg(value_name = "KEY")]
    pub key: Option<String>,
    /// Print all keys as Markdown
    #[arg(long, conflicts_with = "key")]
    pub markdown: bool,
}

/// Arguments of `kinegrad completions`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad completions bash > ~/.local/share/bash-completion/completions/kinegrad
  kinegrad completions zsh > ~/.zfunc/_kinegrad
  kinegrad completions fish > ~/.config/fish/completions/kinegrad.fish")]
pub struct CompletionsArguments {
    /// Shell
    pub shell: Shell,
}

/// Arguments of `kinegrad man`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad man --out ~/.local/share/man/man1 && man kinegrad-train")]
pub struct ManArguments {
    /// Output folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
