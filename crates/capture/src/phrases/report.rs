//! Reports of phrases.

use serde::{Deserialize, Serialize};

use crate::plan::Grid;
use crate::prepare::{Rejection, Report};

/// Report of the preparation of a dataset of phrases.
#[derive(Clone, Debug, Serialize)]
pub struct PhrasesReport {
    /// Address of the dataset.
    pub output: String,
    /// Phrases in the dataset.
    pub phrases: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Takes that were unchanged since an earlier preparation.
    pub kept: usize,
    /// Phrases in the output folder that belong to no take of the plan. The dataset does not
    /// include them.
    pub stale: usize,
    /// Entries of `split.validation` that match no phrase.
    pub idle_entries: Vec<String>,
    /// Songs that `split.fraction` holds out, and names of held-out takes without a song.
    pub held_out_songs: Vec<String>,
    /// A note about the split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_note: Option<String>,
    /// The takes, sorted by name.
    pub takes: Vec<TakeReport>,
}

/// Report of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct TakeReport {
    /// Its name.
    pub name: String,
    /// Phrases made.
    pub phrases: usize,
    /// Seconds of motion in them.
    pub seconds: f64,
    /// The reason if the take cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Frames in no phrase.
    pub rejected: Vec<Rejection>,
    /// Notes.
    pub notes: Vec<String>,
    /// For each bar of stated beats: milliseconds from its stated start to the nearest tracked
    /// beat, positive if the beat comes later. Bars before or after all tracked beats are not
    /// listed.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub bar_offsets_ms: Vec<f64>,
    /// Agreement of stated and tracked beats, for segments with a song.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub grid: Option<GridReport>,
}

/// Agreement of the stated beats of a take with the beats tracked in its song.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct GridReport {
    /// The beats that the segments are aligned with.
    pub grid: Grid,
    /// Stated beats within the song.
    pub stated_beats: f64,
    /// Beats tracked there.
    pub tracked_beats: usize,
    /// Their mean tempo in beats per minute.
    pub tracked_tempo: f64,
    /// Seconds from the stated start to the nearest tracked beat, positive if the beat comes later.
    pub offset_seconds: f64,
    /// Range of the difference between tracked and even beats over the take, seconds.
    pub drift_seconds: f64,
    /// The same in beats.
    pub drift_beats: f64,
    /// Concentration of the difference in beat phase between even and tracked beats over the frames
    /// of the take: 1 if it is constant, 0 if it is uniform.
    pub uniform_concentration: f64,
    /// The concentration between the written phase and tracked beats.
    pub concentration: f64,
}

impl Report for TakeReport {
    fn failed(name: &str, problem: String) -> Self {
        Self {
            name: name.to_owned(),
            failure: Some(problem),
            ..Self::default()
        }
    }

    fn problems(&self) -> (Option<&str>, &[Rejection]) {
        (self.failure.as_deref(), &self.rejected)
    }
}
