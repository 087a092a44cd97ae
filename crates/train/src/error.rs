use std::path::PathBuf;

use kinegrad_settings::{DocumentError, InvalidSetting, counted};
use miette::Diagnostic;
use thiserror::Error;

use crate::config::ConfigError;

/// Errors of a run.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// The config is wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Config(#[from] ConfigError),
    /// Another rank ended the run, with its reason.
    #[error("rank {rank} ended the run")]
    OtherRank {
        /// The rank.
        rank: usize,
        /// Its exit code.
        code: u8,
    },
    /// The weights of the ranks differ.
    #[error("after step {step}, rank {rank} has other weights than rank 0")]
    #[diagnostic(help(
        "all ranks need the same build and the same kind of processor; the last checkpoint is good"
    ))]
    RanksDiffer {
        /// The step.
        step: u64,
        /// The rank.
        rank: usize,
    },
    /// The dataset is wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Data(kinegrad_data::Error),
    /// A file of data cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    File(#[from] kinegrad_data::FileError),
    /// A motion or its statistics are wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Motion(#[from] kinegrad_motion::Error),
    /// An invalid setting.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),
    /// The weights do not fit the network.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Model(#[from] kinegrad_models::Error),
    /// Invalid settings of the diffusion process or a sampler.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Diffusion(kinegrad_diffusion::Error),
    /// Sampling was interrupted.
    #[error("interrupted: what was not finished is not written")]
    #[diagnostic(help("what was written before is complete"))]
    Interrupted,
    /// An invalid emphasis projection.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Emphasis(#[from] kinegrad_motion::emphasis::EmphasisError),
    /// A run of the wrong system.
    #[error("the run's recipe is `{recipe}`, needed: {known}")]
    #[diagnostic(help("use a run of one of these recipes"))]
    OtherRecipe {
        /// The run's recipe.
        recipe: String,
        /// The recipes that fit.
        known: String,
    },
    /// A run on the wrong representation of motion.
    #[error("the run's recipe, `{recipe}`, does not train on {expected}")]
    #[diagnostic(help("use a run of a recipe that does"))]
    OtherRepresentation {
        /// The run's recipe.
        recipe: String,
        /// Name of the representation that is needed.
        expected: String,
    },
    /// Invalid joint features.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Features(#[from] kinegrad_motion::humanml::FeatureError),
    /// Weights of another program that cannot be read.
    #[error("{} cannot be imported: {reason}", path.display())]
    #[diagnostic(help(
        "give a file that `torch.save` wrote: one with `model` and `model_avg`, or a bare state dict"
    ))]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// A text encoder that cannot be used.
    #[error("{}: {reason}", path.display())]
    #[diagnostic(help(
        "option `text_encoder` takes a local folder with CLIP ViT-B/32 as the model hub has it: config.json, \
         model.safetensors, vocab.json and merges.txt (docs/dataset.md)"
    ))]
    TextEncoder {
        /// The folder, or the file in it.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// Weights of another program that do not fit.
    #[error(
        "{} does not fit: {}: {}",
        path.display(),
        counted(differences.len(), "difference"),
        differences.join("; ")
    )]
    #[diagnostic(help(
        "the weights belong to another network: check option `arch`; `evaluation.evaluator.weights` \
         is the published `finest.tar` of the same dataset, option `text_encoder` a folder with CLIP ViT-B/32"
    ))]
    ForeignWeights {
        /// The file.
        path: PathBuf,
        /// All differences.
        differences: Vec<String>,
    },
    /// Weights of another program with numbers that are not finite.
    #[error("{}: `{name}` contains NaN or infinity", path.display())]
    #[diagnostic(help(
        "the training that wrote the file diverged, or the file is damaged: take an earlier checkpoint, \
         or copy it again"
    ))]
    ForeignNumbers {
        /// The file.
        path: PathBuf,
        /// The first such parameter.
        name: String,
    },
    /// An array of the wrong shape.
    #[error("{} contains {found}, allowed: {allowed}", path.display())]
    #[diagnostic(help("`numpy.load` shows the contents"))]
    Array {
        /// The file.
        path: PathBuf,
        /// The contents.
        found: String,
        /// The requirement.
        allowed: String,
    },
    /// A missing run or checkpoint.
    #[error("there is no run or checkpoint at {}", path.display())]
    #[diagnostic(help("{hint}"))]
    RunMissing {
        /// The searched path.
        path: PathBuf,
        /// The valid input.
        hint: String,
    },
    /// A checkpoint without adapters to merge.
    #[error("{} has no low-rank adapters to merge", path.display())]
    #[diagnostic(help(
        "its weights need no merging and are used as they are; adapters are trained with a `lora` table"
    ))]
    NoAdapters {
        /// The checkpoint.
        path: PathBuf,
    },
    /// A checkpoint that cannot be used.
    #[error("the checkpoint {} is damaged: {reason}", path.display())]
    #[diagnostic(help("use another checkpoint in the run's `checkpoints` folder"))]
    CheckpointDamaged {
        /// The checkpoint's folder.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// All existing checkpoints are unusable.
    #[error("no good checkpoint is left in {}:\n{tried}", path.display())]
    #[diagnostic(help("start again under another option `name`"))]
    NoGoodCheckpoint {
        /// Folder of the checkpoints.
        path: PathBuf,
        /// One line for each checkpoint tried.
        tried: String,
    },
    /// The loss or a gradient is not a number.
    #[error("step {step}: {tensor} is not finite; last good checkpoint: {last_good}")]
    #[diagnostic(help(
        "lower `optim.learning_rate` or `train.max_grad_norm`, then start again, or resume from \
         the checkpoint named above"
    ))]
    NotFinite {
        /// The optimizer step that failed, from 1.
        step: u64,
        /// The first tensor with an infinity or NaN.
        tensor: String,
        /// Path of the last good checkpoint, or a note that no checkpoint exists.
        last_good: String,
    },
    /// A generated sample has numbers that are not finite.
    #[error("the sample {sample} is not finite: it is not written")]
    #[diagnostic(help(
        "the sampler overflowed: lower the guidance (`sampling.sampler.guidance_scale`, the goal's \
         weights), clip where the recipe does (`sampling.clip`), or check the model's validation loss"
    ))]
    SampleNotFinite {
        /// Its file name, or its index.
        sample: String,
    },
    /// A request that does not fit the model, or contradictory options.
    #[error("{message}")]
    #[diagnostic(help("{hint}"))]
    Usage {
        /// The fault.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// A song that cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Audio(#[from] kinegrad_audio::Error),
    /// A file operation failed.
    #[error("cannot {action} {}: {source}", path.display())]
    #[diagnostic(help("{}", io_hint(source)))]
    Io {
        /// The attempted action, as a verb.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
}

fn io_hint(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match source.kind() {
        ErrorKind::StorageFull | ErrorKind::FileTooLarge | ErrorKind::QuotaExceeded => {
            "free some space; the last good checkpoint is untouched, option `resume` continues from it"
        }
        ErrorKind::OutOfMemory => "free memory, or give this process more of it",
        ErrorKind::PermissionDenied => "check the folder's owner and rights",
        _ => "check that the path exists and can be written",
    }
}

impl From<DocumentError> for Error {
    fn from(error: DocumentError) -> Self {
        Self::Config(error.into())
    }
}

impl From<kinegrad_data::Error> for Error {
    fn from(error: kinegrad_data::Error) -> Self {
        match error {
            kinegrad_data::Error::Interrupted => Self::Interrupted,
            kinegrad_data::Error::OtherReader { rank, code } => Self::OtherRank { rank, code },
            error => Self::Data(error),
        }
    }
}

impl From<kinegrad_diffusion::Error> for Error {
    fn from(error: kinegrad_diffusion::Error) -> Self {
        match error {
            kinegrad_diffusion::Error::Stopped => Self::Interrupted,
            error => Self::Diffusion(error),
        }
    }
}

impl Error {
    /// Wraps an error of the file system.
    pub fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io {
            action,
            path,
            source,
        }
    }

    /// [`Error::Usage`] with its hint.
    pub fn usage(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Usage {
            message: message.into(),
            hint: hint.into(),
        }
    }

    /// The exit code: 1 for a failure, 2 for invalid input, 130 for an interruption.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::OtherRank { code, .. } => *code,
            Self::RanksDiffer { .. }
            | Self::NotFinite { .. }
            | Self::SampleNotFinite { .. }
            | Self::Io { .. } => 1,
            Self::Data(error) if error.is_failure() => 1,
            Self::Interrupted => 130,
            _ => 2,
        }
    }
}
