//! Errors about the settings, folder and files of a dataset.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use kinegrad_settings::InvalidSetting;
use miette::Diagnostic;
use thiserror::Error;

use crate::magnitude::allowed;
use crate::{Item, StoreError};

/// The reason an array file cannot be used. `file` is its path, followed by `:member` in an
/// archive.
#[derive(Debug, Error, Diagnostic)]
pub enum FileError {
    /// The file cannot be read or used.
    #[error("{file}: {problem}")]
    #[diagnostic(help("{hint}"))]
    Unusable {
        /// The file, and the line or array in it.
        file: String,
        /// The problem.
        problem: String,
        /// The hint.
        hint: String,
    },
    /// The store could not give the file.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Store(#[from] StoreError),
}

/// The reason a dataset could not be opened or written.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// A progress callback stopped the work.
    #[error("interrupted")]
    #[diagnostic(help("nothing is left half-written; run it again"))]
    Interrupted,
    /// Another rank failed.
    #[error("rank {rank} cannot read its part of the dataset")]
    OtherReader {
        /// The rank.
        rank: usize,
        /// Its exit code.
        code: u8,
    },
    /// Ranks list different items.
    #[error("data.source: rank {rank} finds other {kind}s there than rank 0")]
    #[diagnostic(help("the dataset belongs on a file system or in a bucket that all ranks see"))]
    OtherListing {
        /// `phrase` or `clip`.
        kind: &'static str,
        /// The first rank that differs.
        rank: usize,
    },
    /// A value of the `data` table is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Config(#[from] InvalidSetting),
    /// The scheme of `data.source` is not supported.
    #[error(
        "data.source = \"{found}\": `{scheme}` found; a folder, file:///FOLDER, gs://BUCKET/PREFIX, \
         s3://BUCKET/PREFIX, http:// and https:// allowed"
    )]
    #[diagnostic(help("copy the dataset to a local folder and name that"))]
    Scheme {
        /// The whole value.
        found: String,
        /// Its scheme.
        scheme: String,
    },
    /// The build lacks a feature.
    #[error("{what}: this build of kinegrad lacks the feature `{feature}`")]
    #[diagnostic(help(
        "build kinegrad with the Cargo feature `full` (or `{feature}`), or build and install the wheel, \
         which has it: `pip install $(scripts/wheel)` in a checkout"
    ))]
    Feature {
        /// The requested object.
        what: String,
        /// The Cargo feature.
        feature: &'static str,
    },
    /// A store, or an object in it, cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Store(#[from] StoreError),
    /// The manifest is invalid.
    #[error("{object}: {problem}")]
    #[diagnostic(help(
        "docs/dataset.md lists the columns; `kinegrad data prepare` writes a new one"
    ))]
    Manifest {
        /// The manifest.
        object: String,
        /// The problem.
        problem: String,
    },
    /// The dataset's folder, or a required one in it, is missing.
    #[error("data.source: folder {} not found", .0.display())]
    #[diagnostic(help(
        "a dataset contains audio_features/ID/features.npz and motion/ID/trajectory.npy; `kinegrad \
         data synth` makes one to try"
    ))]
    MissingFolder(PathBuf),
    /// The dataset has nothing to train on.
    #[error("{problem}")]
    #[diagnostic(help("{hint}"))]
    NothingToTrainOn {
        /// The problem.
        problem: String,
        /// The hint.
        hint: String,
    },
    /// A phrase or clip is bad and `data.on_bad_phrase` is `error`.
    #[error("{kind} `{id}`: {cause}")]
    #[diagnostic(help("{hint}"))]
    BadItem {
        /// `phrase` or `clip`.
        kind: &'static str,
        /// Its id.
        id: String,
        /// The problem. The field is not named `source`: the message already contains it.
        cause: Box<FileError>,
        /// The hint.
        hint: String,
    },
    /// An address contains credentials or a query.
    #[error("the address {place}... {problem}")]
    #[diagnostic(help(
        "credentials come from the environment, not from the address, which is written into configs \
         and checkpoints"
    ))]
    Address {
        /// Scheme and host.
        place: String,
        /// The problem.
        problem: &'static str,
    },
    /// A file outside any dataset is bad.
    #[error(transparent)]
    #[diagnostic(transparent)]
    File(#[from] FileError),
    /// A file or folder could not be read or written.
    #[error("cannot {action} {}: {reason}", path.display())]
    #[diagnostic(help("check the path, its permissions and the free space"))]
    Io {
        /// The attempted action.
        action: &'static str,
        /// The path.
        path: PathBuf,
        /// The operating system's reason.
        reason: std::io::Error,
    },
    /// The folder already contains a dataset.
    #[error("{} already contains a dataset", .0.display())]
    #[diagnostic(help("name a new folder, or remove the old dataset first"))]
    Exists(PathBuf),
}

impl FileError {
    /// A file that cannot be opened or read.
    pub fn read<E: Display>(file: &Path) -> impl FnOnce(E) -> Self {
        let file = file.display().to_string();
        let hint = "check that the file exists and that you may read it";
        move |reason| Self::unusable(file, format!("cannot be read: {reason}"), hint)
    }

    /// A file with unusable contents.
    pub(crate) fn unusable(
        file: impl Into<String>,
        problem: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Unusable {
            file: file.into(),
            problem: problem.into(),
            hint: hint.into(),
        }
    }

    /// A file with unexpected contents.
    pub(crate) fn unexpected(
        file: impl Into<String>,
        found: impl Display,
        expected: impl Display,
        hint: impl Into<String>,
    ) -> Self {
        Self::unusable(file, format!("found {found}, expected {expected}"), hint)
    }

    /// An array with the wrong shape.
    pub fn shape(file: &str, found: &[usize], allowed: impl Display) -> Self {
        let problem = format!("shape {found:?} found, {allowed} allowed");
        let hint = "motion is [frames, 25]; mel, chroma and mfcc are [128 | 12 | 20, frames]; rms, \
                    spectral_centroid and onset_strength are [frames]";
        Self::unusable(file, problem, hint)
    }

    /// A value that is not [usable](crate::magnitude::is_usable); frames count from 0.
    pub(crate) fn not_usable(file: &str, frame: usize, channel: String, value: f32) -> Self {
        let (allowed, hint) = allowed(value);
        let problem = format!("{value} in frame {frame}, channel {channel}; {allowed} allowed");
        Self::unusable(file, problem, hint)
    }
}

impl Error {
    /// True if the network or disk failed, not the input.
    pub fn is_failure(&self) -> bool {
        let failed = |error: &StoreError| matches!(error, StoreError::Failed { .. });
        match self {
            Self::Io { .. } => true,
            Self::Store(error) => failed(error),
            Self::BadItem { cause, .. } => {
                matches!(&**cause, FileError::Store(error) if failed(error))
            }
            _ => false,
        }
    }

    /// The [`Error::BadItem`] of `id`.
    pub(crate) fn bad<T: Item>(id: &str, cause: FileError) -> Self {
        let kind = T::KIND;
        let hint = match &cause {
            // The item itself has no defect.
            FileError::Store(error) if !error.concerns_one_object() => {
                error.help().map(|help| help.to_string())
            }
            _ => None,
        };
        let hint = hint.unwrap_or_else(|| {
            let of_file = match &cause {
                FileError::Unusable { hint, .. } if !hint.is_empty() => format!("{hint}; "),
                _ => String::new(),
            };
            format!(
                "{of_file}repair or remove the {kind}, or set data.on_bad_phrase = \"skip\"; \
                 `kinegrad data inspect` lists every problem"
            )
        });
        Self::BadItem {
            kind,
            id: id.to_owned(),
            cause: Box::new(cause),
            hint,
        }
    }

    /// An [`Error::Config`] of `data.kind`.
    pub(crate) fn wrong_kind(kind: impl Display, allowed: &str, hint: &str) -> Self {
        let found = format!("\"{kind}\"");
        InvalidSetting::new("data.kind", found, allowed)
            .hint(hint)
            .into()
    }

    /// An [`Error::Io`]: `action` is a verb ("read", "write").
    pub fn io(action: &'static str, path: impl Into<PathBuf>, reason: std::io::Error) -> Self {
        Self::Io {
            action,
            path: path.into(),
            reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lean_build_names_the_wheel_and_the_feature() {
        let lacking = Error::Feature {
            what: "manifest.parquet".to_owned(),
            feature: "manifest",
        };
        let help = lacking.help().expect("a hint").to_string();
        assert!(help.contains("pip install $(scripts/wheel)") && help.contains("`full`"));
    }
}
