//! Reports of phrases.

use serde::{Deserialize, Serialize};

use crate::plan::Grid;
use crate::prepare::{Rejection, Report};

/// What became of a plan.
#[derive(Clone, Debug, Serialize)]
pub struct PhrasesReport {
    /// Where the dataset is.
    pub output: String,
    /// Phrases in it.
    pub phrases: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Takes that had been made before.
    pub kept: usize,
    /// Phrases that lie there and belong to no take of the plan, and so not to the dataset.
    pub stale: usize,
    /// Entries of `split.validation` that match no phrase.
    pub idle_entries: Vec<String>,
    /// Songs held out whole, where the plan names no phrase; a take without a song by its name.
    pub held_out_songs: Vec<String>,
    /// What there is to say of the split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_note: Option<String>,
    /// Each take, by name.
    pub takes: Vec<TakeReport>,
}

/// What became of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct TakeReport {
    /// Its name.
    pub name: String,
    /// Phrases made.
    pub phrases: usize,
    /// Seconds of motion in them.
    pub seconds: f64,
    /// Why nothing could be made of it at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// What was left out.
    pub rejected: Vec<Rejection>,
    /// What a user should know of the rest.
    pub notes: Vec<String>,
    /// Where the plan states the beats: from the stated beginning of each bar to the nearest tracked
    /// beat, whichever of the two the motion is laid on, in milliseconds, positive where the music comes later. Bars that lie wholly before or
    /// after all tracked beats are left out.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub bar_offsets_ms: Vec<f64>,
    /// Of segments with a song: which beats they lie on, and how stated and tracked ones agree.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub grid: Option<GridReport>,
}

/// How the stated beats of a take and those of its song agree.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct GridReport {
    /// What the segments were laid on.
    pub grid: Grid,
    /// Beats that the plan states within the song.
    pub stated_beats: f64,
    /// Beats tracked there.
    pub tracked_beats: usize,
    /// Their mean tempo in beats per minute.
    pub tracked_tempo: f64,
    /// From the stated start to the nearest tracked beat in seconds, positive where the music comes
    /// later.
    pub offset_seconds: f64,
    /// How far tracked beats and even ones move apart over the take, in seconds: the largest
    /// difference less the smallest.
    pub drift_seconds: f64,
    /// The same in beats.
    pub drift_beats: f64,
    /// Concentration of the difference in beat phase between even beats and tracked ones, over the
    /// frames of the take: 1 where it is always the same, 0 where it takes every value alike.
    pub uniform_concentration: f64,
    /// The same between the phase that was written and tracked beats.
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

    fn name(&self) -> &str {
        &self.name
    }

    fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    fn rejected(&self) -> &[Rejection] {
        &self.rejected
    }
}
