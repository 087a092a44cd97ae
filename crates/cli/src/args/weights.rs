//! Arguments of `kinegrad import` and `kinegrad merge`.

use std::path::PathBuf;

use clap::Args;

/// Arguments of `kinegrad import`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad import model000500000.pt --arch gmd_motion --mean Mean_abs_3d.npy --std Std_abs_3d.npy \
--projection rand_proj.npy --out runs/gmd")]
pub struct ImportArguments {
    /// PyTorch file
    #[arg(value_name = "WEIGHTS.pt")]
    pub weights: PathBuf,
    /// Model architecture: gmd_motion, gmd_trajectory, mdm or flowmdm
    #[arg(long)]
    pub arch: String,
    /// Mean of the training data, one value per feature; a trajectory model needs all features too
    #[arg(long, value_name = "M.npy")]
    pub mean: Option<PathBuf>,
    /// Standard deviation of the training data
    #[arg(long, value_name = "S.npy")]
    pub std: Option<PathBuf>,
    /// Emphasis projection matrix used in training
    #[arg(long, value_name = "P.npy")]
    pub projection: Option<PathBuf>,
    /// Number of frames that a UNet pads clips to (default: 224)
    #[arg(long, value_name = "T")]
    pub padded_frames: Option<usize>,
    /// Use `model`, the weights of the last step, instead of `model_avg`
    #[arg(long)]
    pub last: bool,
    /// Set a key of the new run's config, for example steering.guidance.norm=mse
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Arguments of `kinegrad merge`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad merge runs/e2e-lora --out runs/e2e-merged")]
pub struct MergeArguments {
    /// Run (its best checkpoint is used) or checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
