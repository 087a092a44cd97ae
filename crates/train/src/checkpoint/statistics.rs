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

impl Statistics {
    /// Those of phrases.
    ///
    /// # Errors
    /// [`Error::NotPhrases`] if the run was trained on clips.
    pub fn phrases(&self) -> Result<&TrainingStatistics, Error> {
        match self {
            Self::Phrases(statistics) => Ok(statistics),
            Self::Features(_) => Err(Error::NotPhrases),
        }
    }

    /// Those of clips of joint features.
    ///
    /// # Errors
    /// [`Error::NotClips`] if the run was trained on phrases.
    pub fn features(&self) -> Result<&FeatureStatistics, Error> {
        match self {
            Self::Features(statistics) => Ok(statistics),
            Self::Phrases(_) => Err(Error::NotClips),
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
