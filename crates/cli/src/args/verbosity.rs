//! Options of every command.

use clap::Args;

/// The amount of output.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct VerbosityArgs {
    /// Print only results, warnings and errors
    #[arg(short, long, global = true, display_order = 1000)]
    pub quiet: bool,
    /// Print details; RUST_LOG sets the level by module
    #[arg(
        short,
        long,
        global = true,
        display_order = 1000,
        conflicts_with = "quiet"
    )]
    pub verbose: bool,
}
