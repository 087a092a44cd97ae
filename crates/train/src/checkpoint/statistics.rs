//! What a run remembers of its training data.

use kinegrad_motion::TrainingStatistics;
use kinegrad_motion::humanml::FeatureStatistics;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Statistics of the training data, of either kind of dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Statistics {
    /// Of 25-channel phrases.
    Phrases(TrainingStatistics),
    /// Of clips of joint features.
    Features(FeatureStatistics),
}

/// The error of a run on phrases where one on clips is needed.
pub(crate) fn not_clips() -> Error {
    Error::usage(
        "the run's recipe trains on phrases, not on clips of joint features",
        "give a run of recipe `gmd_motion` or `gmd_trajectory`",
    )
}

impl Statistics {
    /// Those of phrases.
    ///
    /// # Errors
    /// If the run was trained on clips.
    pub fn phrases(&self) -> Result<&TrainingStatistics, Error> {
        match self {
            Self::Phrases(statistics) => Ok(statistics),
            Self::Features(_) => Err(Error::usage(
                "the run's recipe trains on clips of joint features, not on phrases",
                "give a run of recipe `diffusion`, `decoder` or `e2e`",
            )),
        }
    }

    /// Those of clips of joint features.
    ///
    /// # Errors
    /// If the run was trained on phrases.
    pub fn features(&self) -> Result<&FeatureStatistics, Error> {
        match self {
            Self::Features(statistics) => Ok(statistics),
            Self::Phrases(_) => Err(not_clips()),
        }
    }
}

impl From<TrainingStatistics> for Statistics {
    fn from(statistics: TrainingStatistics) -> Self {
        Self::Phrases(statistics)
    }
}

impl From<FeatureStatistics> for Statistics {
    fn from(statistics: FeatureStatistics) -> Self {
        Self::Features(statistics)
    }
}
