//! Agreement of the phase channel with the beats of the music.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use kinegrad_motion::metrics::Estimate;
use serde::Serialize;

use crate::{BeatPhrase, PhraseItem, Songs};

/// Distance between unrelated beats, in beats.
pub const CHANCE: f64 = 0.25;

/// Distance between two sets of beats over phrases, in beats: 0 to 0.5, by chance 0.25.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BeatAgreement {
    /// Phrases with beats.
    pub phrases: usize,
    /// Their songs.
    pub songs: usize,
    /// Mean over phrases, with its 95 % interval over songs.
    #[serde(flatten)]
    pub error: Estimate,
}

impl BeatAgreement {
    /// Fewest phrases of a verdict: the interval of fewer says little.
    pub const FEWEST_PHRASES: usize = 4;

    /// The agreement of phrases, each with its song and the distance of its beats; `None` without
    /// phrases, or if a distance is not finite.
    pub fn of(distances: impl IntoIterator<Item = (String, f64)>) -> Option<Self> {
        let mut songs: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for (song, distance) in distances {
            songs.entry(song).or_default().push(distance);
        }
        let groups: Vec<Vec<f64>> = songs.into_values().collect();
        Some(Self {
            phrases: groups.iter().map(Vec::len).sum(),
            songs: groups.len(),
            error: Estimate::of(&groups, 0)?,
        })
    }

    /// The agreement of the phrases' phase channels with the beats tracked in their music.
    pub fn with_tracked(phrases: &[Arc<PhraseItem>], songs: &Songs) -> Option<Self> {
        let distances = phrases.iter();
        Self::of(distances.filter_map(|phrase| tracked_error(phrase.clone(), songs)))
    }

    /// True if the beats may agree by chance only: there are enough phrases, and the interval
    /// reaches 0.25.
    pub fn is_at_chance(&self) -> bool {
        self.phrases >= Self::FEWEST_PHRASES && self.error.high >= CHANCE
    }
}

/// Song and [`tracked_error`](BeatPhrase::tracked_error) of a phrase with beats.
pub fn tracked_error(phrase: Arc<PhraseItem>, songs: &Songs) -> Option<(String, f64)> {
    let phrase = BeatPhrase::new(phrase, songs, None)?;
    let distance = phrase.tracked_error()?;
    Some((phrase.song, distance))
}

impl fmt::Display for BeatAgreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Estimate { mean, low, high } = self.error;
        write!(
            f,
            "{mean:.3} beats ({low:.3} to {high:.3}; by chance {CHANCE})"
        )
    }
}
