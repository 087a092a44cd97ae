//! Importing weights of other programs: requests and results.

use std::path::PathBuf;

use crate::config::Config;

/// What is imported. A system refuses what its networks have no use for.
#[derive(Clone, Debug)]
pub struct ImportRequest {
    /// The file that `torch.save` wrote.
    pub weights: PathBuf,
    /// What it is of: one of a system's [`architectures`](crate::systems::System::architectures).
    pub architecture: String,
    /// `.npy` file of the training data's mean, one number a channel.
    pub mean: Option<PathBuf>,
    /// `.npy` file of its standard deviation.
    pub std: Option<PathBuf>,
    /// `.npy` file of a projection's matrix, for a model that works in a projected space.
    pub projection: Option<PathBuf>,
    /// Frames that the network pads every clip to.
    pub padded_frames: usize,
    /// Take the weights of the last step and not their moving average.
    pub last: bool,
    /// Settings of the new run, `KEY=VALUE`, in place of the recipe's defaults.
    pub overrides: Vec<String>,
    /// Folder of the new run.
    pub out: PathBuf,
}

/// What was imported.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The checkpoint.
    pub path: PathBuf,
    /// Number of parameters.
    pub parameters: usize,
    /// The part of the file that was read, or none for a bare state dict.
    pub part: Option<&'static str>,
    /// Names that are known and not needed.
    pub skipped: usize,
    /// The resolved config.
    pub config: Config,
    /// What is doubtful.
    pub warnings: Vec<String>,
}
