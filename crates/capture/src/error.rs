//! Errors about capture files, marker sets and plans.

use std::fmt::Display;
use std::path::Path;

use kinegrad_data::StoreError;
use kinegrad_settings::{DocumentError, InvalidSetting, Refused};
use miette::Diagnostic;
use thiserror::Error;

/// The hint of errors about plans.
pub(crate) const PLANS: &str = "`kinegrad init prepare` (phrases) and `kinegrad init bodies` \
     (clips) write plans to start from; docs/dataset.md describes them";

/// An error about motion capture or a plan.
#[derive(Debug, Diagnostic, Error)]
pub enum Error {
    /// A capture file breaks its format.
    #[error("`{file}`, {place}: found {found}, expected {allowed}")]
    #[diagnostic(help("{hint}"))]
    Format {
        /// Name of the file.
        file: String,
        /// The line, counted from 1, or the section with its byte, counted from 0.
        place: String,
        /// The text or bytes found there.
        found: String,
        /// The values allowed there.
        allowed: String,
        /// The remedy.
        hint: &'static str,
    },

    /// A file has no marker or joint of a name, or several of that name.
    #[error("{problem}")]
    #[diagnostic(help("{hint}"))]
    Name {
        /// The file, the name and the problem.
        problem: String,
        /// The names in the file, or the remedy.
        hint: String,
    },

    /// A frame, or every frame of a take, lacks the root.
    #[error("{problem}")]
    #[diagnostic(help("{hint}"))]
    NoPose {
        /// The frame or file and the problem.
        problem: String,
        /// The remedy.
        hint: &'static str,
    },

    /// A setting, or a field of a segment, is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),

    /// A plan that is refused.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Document(#[from] DocumentError),

    /// A plan, or a file that it names, cannot be used.
    #[error("{file}: {problem}")]
    #[diagnostic(help("{PLANS}"))]
    Plan {
        /// The plan, or the file.
        file: String,
        /// The problem.
        problem: String,
    },

    /// Another preparation is writing the same dataset.
    #[error("{output}: another preparation is writing there")]
    #[diagnostic(help("wait until it has ended, or write to another place with option `out`"))]
    Busy {
        /// The dataset.
        output: String,
    },

    /// The dataset cannot be written.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Data(#[from] kinegrad_data::Error),

    /// The phrase itself cannot be made.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Motion(#[from] kinegrad_motion::Error),

    /// Joints that belong to another skeleton.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Features(#[from] kinegrad_motion::humanml::FeatureError),
}

impl From<StoreError> for Error {
    fn from(error: StoreError) -> Self {
        Self::Data(error.into())
    }
}

impl Error {
    /// An [`Error::Plan`].
    pub(crate) fn plan(file: &Path, problem: impl ToString) -> Self {
        Self::Plan {
            file: file.display().to_string(),
            problem: problem.to_string(),
        }
    }

    /// An [`Error::Format`] about `found` at `place`.
    pub(crate) fn format(
        file: &str,
        place: String,
        found: impl Into<String>,
        allowed: &str,
        hint: &'static str,
    ) -> Self {
        Self::Format {
            file: file.to_string(),
            place,
            found: found.into(),
            allowed: allowed.to_string(),
            hint,
        }
    }

    /// The error with its hint, on one line.
    pub(crate) fn with_hint(&self) -> String {
        let hint = self.help().map(|hint| format!(" ({hint})"));
        format!("{self}{}", hint.unwrap_or_default())
    }
}

/// [`kinegrad_settings::require`] with a hint about plans.
pub(crate) fn require(
    holds: bool,
    key: impl Display,
    found: impl Display,
    allowed: impl Display,
) -> Result<(), InvalidSetting> {
    kinegrad_settings::require(holds, key, found, allowed).hint(PLANS)
}

/// [`require`] of a finite number above 0.
pub(crate) fn require_positive(
    key: impl Display,
    number: f64,
    allowed: &str,
) -> Result<(), InvalidSetting> {
    require(number.is_finite() && number > 0.0, key, number, allowed)
}

/// Text from a file in backticks, shortened to fit a message.
pub(crate) fn quote(text: &str) -> String {
    const LONGEST: usize = 40;
    let mut shown: String = text.chars().take(LONGEST).collect();
    if shown.len() < text.len() {
        shown.push_str("...");
    }
    format!("`{}`", shown.escape_debug())
}
