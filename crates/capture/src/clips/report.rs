//! Reports of clips.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::captions::Labels;
use crate::UpAxis;
use crate::prepare::{Rejection, Report};

/// Report of the preparation of a dataset of clips.
#[derive(Clone, Debug, Serialize)]
pub struct ClipsReport {
    /// Address of the dataset.
    pub output: String,
    /// Clips in the dataset, including mirrored clips.
    pub clips: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Number of clips by set.
    pub parts: BTreeMap<String, usize>,
    /// Takes that were unchanged since an earlier preparation.
    pub kept: usize,
    /// Clips in the output folder that belong to no take of the plan. The dataset does not include
    /// them.
    pub stale: usize,
    /// Entries of `split.validation` and `split.test` that match no take.
    pub idle_entries: Vec<String>,
    /// Notes about the split.
    pub split_notes: Vec<String>,
    /// True if the dataset has a manifest.
    pub manifest: bool,
    /// The takes, sorted by name.
    pub takes: Vec<ClipTakeReport>,
}

/// Report of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct ClipTakeReport {
    /// Its name.
    pub name: String,
    /// Clips made, including mirrored clips.
    pub clips: usize,
    /// Length of the part that is used, seconds.
    pub seconds: f64,
    /// Its labels.
    pub labels: Labels,
    /// The number of the take in its name.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub number: Option<u64>,
    /// The joint map.
    pub map: String,
    /// Metres of a unit of its file.
    pub metres_per_unit: f64,
    /// The axis of its file that points up.
    pub up: UpAxis,
    /// The reason if the take cannot be used.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failure: Option<String>,
    /// Frames in no clip: takes that are too short, and ends of long takes.
    pub skipped: Vec<Rejection>,
    /// Notes.
    pub notes: Vec<String>,
}

impl Report for ClipTakeReport {
    fn failed(name: &str, problem: String) -> Self {
        Self {
            name: name.to_owned(),
            failure: Some(problem),
            ..Self::default()
        }
    }

    fn problems(&self) -> (Option<&str>, &[Rejection]) {
        (self.failure.as_deref(), &self.skipped)
    }
}
