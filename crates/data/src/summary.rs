//! Range, mean and deviation of what phrases hold.

use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::{CHANNELS, ChannelMoments, channel_name};
use serde::Serialize;

use crate::Phrase;
use crate::features::FEATURES;

/// Range, mean and standard deviation over all frames of all usable phrases.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// The channel.
    pub name: String,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

/// Each of the 25 channels; nothing where there are no phrases.
pub(crate) fn summarise_motion(phrases: &[Arc<Phrase>]) -> Vec<ChannelSummary> {
    let Ok(moments) = ChannelMoments::compute(phrases.iter().map(|phrase| &phrase.motion)) else {
        return Vec::new();
    };
    (0..CHANNELS)
        .map(|channel| ChannelSummary {
            name: channel_name(channel),
            min: moments.min[channel],
            max: moments.max[channel],
            mean: moments.mean[channel],
            std: moments.std[channel],
        })
        .collect()
}

/// Each array of audio features, its rows taken together; nothing where there are no phrases.
pub(crate) fn summarise_audio(phrases: &[Arc<Phrase>]) -> Vec<ChannelSummary> {
    if phrases.is_empty() {
        return Vec::new();
    }
    let mut first = 0;
    FEATURES
        .into_iter()
        .map(|(name, rows)| {
            let channels = first..first + rows;
            first += rows;
            summarise(name, phrases, &channels)
        })
        .collect()
}

fn summarise(name: &str, phrases: &[Arc<Phrase>], channels: &Range<usize>) -> ChannelSummary {
    let values = || {
        phrases.iter().flat_map(|phrase| {
            let rows = phrase.audio.frames();
            &phrase.audio.as_slice()[channels.start * rows..channels.end * rows]
        })
    };
    let (mut count, mut sum) = (0usize, 0.0);
    let (mut min, mut max) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values().map(|&value| f64::from(value)) {
        count += 1;
        sum += value;
        min = min.min(value);
        max = max.max(value);
    }
    let mean = sum / count.max(1) as f64;
    let square: f64 = values()
        .map(|&value| (f64::from(value) - mean).powi(2))
        .sum();
    let std = (square / count.max(1) as f64).sqrt();
    ChannelSummary {
        name: name.to_owned(),
        min,
        max,
        mean,
        std,
    }
}
