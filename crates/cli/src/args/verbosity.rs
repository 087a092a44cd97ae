//! How much a command says.

use clap::Args;

/// Options of every command.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct VerbosityArgs {
    /// Print no progress and no notes, only results, warnings and errors
    #[arg(
        short,
        long,
        global = true,
        conflicts_with = "verbose",
        display_order = 1000
    )]
    pub quiet: bool,
    /// Print what is read, written and chosen; RUST_LOG sets the level by module
    #[arg(short, long, global = true, display_order = 1000)]
    pub verbose: bool,
}
