//! Reports of clips.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::captions::Labels;
use crate::UpAxis;
use crate::prepare::{Rejection, Report};

/// What became of a plan of clips.
#[derive(Clone, Debug, Serialize)]
pub struct ClipsReport {
    /// Where the dataset is.
    pub output: String,
    /// Clips in it, mirrored ones too.
    pub clips: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Clips on each list.
    pub parts: BTreeMap<String, usize>,
    /// Takes that had been made before.
    pub kept: usize,
    /// Clips that lie there and belong to no take of the plan, and so not to the dataset.
    pub stale: usize,
    /// Entries of `split.validation` and `split.test` that match no take.
    pub idle_entries: Vec<String>,
    /// What a user should know of how the takes were divided.
    pub split_notes: Vec<String>,
    /// Whether the dataset has a manifest.
    pub manifest: bool,
    /// Each take, by name.
    pub takes: Vec<ClipTakeReport>,
}

/// What became of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct ClipTakeReport {
    /// Its name.
    pub name: String,
    /// Clips made, mirrored ones too.
    pub clips: usize,
    /// Its length in seconds, as far as it was used.
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
    /// Why nothing could be made of it at all.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failure: Option<String>,
    /// Frames that no clip holds: takes that are too short, and what long ones leave over.
    pub skipped: Vec<Rejection>,
    /// What a user should know of the rest.
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

    fn name(&self) -> &str {
        &self.name
    }

    fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    fn rejected(&self) -> &[Rejection] {
        &self.skipped
    }
}
