//! Summary and problems of a dataset.

use std::ops::Range;

use kinegrad_motion::{ChannelMoments, Measured, Profile, Representation, Statistics};
use kinegrad_ranks::Alone;
use kinegrad_settings::counted;
use serde::{Deserialize, Serialize};

use crate::humanml::Clip;
use crate::item::Item;
use crate::progress::{OpenProgress, no_progress};
use crate::scan::Listable;
use crate::{BeatAgreement, DataConfig, Dataset, Error, PhraseItem, Songs};

/// Summary of a dataset. All numbers refer to usable items.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// The dataset's address, or `synthetic` or `synthetic_walks`.
    pub source: String,
    /// Kind of the items: `phrase` or `clip`.
    pub kind: &'static str,
    /// Name of the representation.
    pub representation: String,
    /// Usable items.
    pub items: usize,
    /// Unusable items.
    pub bad_items: usize,
    /// Valid items that are left out, such as clips outside the length limits.
    pub left_out: usize,
    /// Training items.
    pub train: usize,
    /// Held-out items.
    pub validation: usize,
    /// Total number of frames.
    pub frames: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Frames per second.
    pub fps: f64,
    /// Frames of the shortest item.
    pub shortest_frames: usize,
    /// Frames of the longest item.
    pub longest_frames: usize,
    /// Channels of the motion.
    pub channels: usize,
    /// Counts of conditions, by name.
    pub counts: Vec<(String, usize)>,
    /// Summary of each motion channel, or group of channels, in the dataset's units.
    pub motion: Vec<ChannelSummary>,
    /// Summary of each condition.
    pub conditions: Vec<ChannelSummary>,
    /// Distance between the beats of the phase channel and the beats tracked in the music; `None`
    /// without beats.
    pub beats: Option<BeatAgreement>,
    /// Problems of single items, by id.
    pub problems: Vec<Problem>,
    /// Warnings about the dataset as a whole.
    pub warnings: Vec<String>,
}

/// Range, mean and standard deviation over all frames of all usable items.
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

impl ChannelSummary {
    /// Summary of several channels together.
    fn of(name: &str, moments: &ChannelMoments, channels: Range<usize>) -> Self {
        let channel = |c: usize| ChannelMoments {
            mean: vec![moments.mean[c]],
            std: vec![moments.std[c]],
            min: vec![moments.min[c]],
            max: vec![moments.max[c]],
            ..*moments
        };
        let mut together = channel(channels.start);
        (channels.start + 1..channels.end).for_each(|c| together.merge(&channel(c)));
        Self {
            name: name.to_owned(),
            min: together.min[0],
            max: together.max[0],
            mean: together.mean[0],
            std: together.std[0],
        }
    }
}

/// A problem of an item.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// The item.
    pub id: String,
    /// The problem.
    pub problem: String,
    /// True if the item is unusable.
    pub unusable: bool,
}

/// Measured values of one or several items.
#[derive(Deserialize, Serialize)]
struct Contents {
    motion: Measured,
    conditions: Vec<(String, ChannelMoments)>,
    counts: Vec<(String, usize)>,
    beats: Vec<(String, f64)>,
}

impl Contents {
    fn of<T: Item>(item: &T, representation: &T::Representation, songs: &Songs) -> Self {
        let conditions = item.conditions().into_iter();
        let counts = item.counts().into_iter();
        Self {
            motion: Measured::of(representation, &item.rows(representation)),
            conditions: conditions
                .map(|(name, values)| (name.to_owned(), ChannelMoments::measure(1, [values])))
                .collect(),
            counts: counts
                .map(|(name, count)| (name.to_owned(), count))
                .collect(),
            beats: item.tracked_beats(songs).into_iter().collect(),
        }
    }

    fn merge(&mut self, other: Self) {
        self.motion.merge(other.motion);
        for ((_, all), (_, moments)) in self.conditions.iter_mut().zip(&other.conditions) {
            all.merge(moments);
        }
        for ((_, all), (_, count)) in self.counts.iter_mut().zip(other.counts) {
            *all += count;
        }
        self.beats.extend(other.beats);
    }
}

/// Reads every item of the dataset of `config`, regardless of `on_bad_phrase`, and checks each item
/// by both profiles. The strict profile uses the statistics of the training items or, without
/// training items, of all items. Fails as [`Dataset::open`], but never for a bad item or an empty
/// split.
pub fn inspect(config: &DataConfig, progress: OpenProgress) -> Result<Inspection, Error> {
    config.validate()?;
    match config.kind.is_clips() {
        false => inspect_items::<PhraseItem>(config, progress),
        true => inspect_items::<Clip>(config, progress),
    }
}

/// The training motion statistics of the dataset of `config`. Fails as [`Dataset::open`].
pub fn statistics(config: &DataConfig) -> Result<Statistics, Error> {
    match config.kind.is_clips() {
        false => Dataset::<PhraseItem>::open(config)?.statistics(),
        true => Dataset::<Clip>::open(config)?.statistics(),
    }
}

fn inspect_items<T: Listable>(
    config: &DataConfig,
    progress: OpenProgress,
) -> Result<Inspection, Error> {
    let songs = Songs::read(config)?;
    let mut scan = T::scan(config)?;
    let gathered = scan.gather(config, None, progress, &Alone)?;
    let (skipped, left_out) = (gathered.skipped, gathered.left_out);
    let (kind, representation) = (T::KIND, scan.representation.clone());
    let mut warnings = std::mem::take(&mut scan.warnings);
    let source = match scan.source.files() {
        Some(files) => files.store.uri(),
        None => config.kind.to_string(),
    };
    let lengths: Vec<usize> = gathered.entries.iter().map(|entry| entry.frames).collect();
    let (train, validation, _) = scan.divide(gathered.entries, gathered.memory);

    let problem = |unusable| {
        move |(id, problem)| Problem {
            id,
            problem,
            unusable,
        }
    };
    let mut problems: Vec<Problem> = gathered.notes.into_iter().map(problem(false)).collect();
    let bad_items = skipped.len();
    problems.extend(skipped.into_iter().map(problem(true)));
    if train.is_empty() {
        warnings.push(format!("no {kind} is left to train on"));
    }
    if let Some((id, reason)) = left_out.first() {
        let items = counted(left_out.len(), kind);
        warnings.push(format!(
            "{items} left out; the first: {kind} `{id}`: {reason}"
        ));
    }

    let mut all: Option<Contents> = None;
    let mut of_training = None;
    for side in [&train, &validation] {
        side.measure_among(
            |item| Contents::of(item, &representation, &songs),
            |contents| match &mut all {
                Some(all) => all.merge(contents),
                None => all = Some(contents),
            },
            &no_progress,
            &Alone,
        )?;
        let measured = || all.as_ref().map(|all| all.motion.clone());
        of_training = of_training.or_else(measured);
    }
    let statistics = of_training.map(|measured| measured.statistics(&representation));
    for side in [&train, &validation] {
        let failed = |item: &T| {
            let rows = item.rows(&representation);
            let checks = [Profile::Strict, Profile::Ccmotion].into_iter();
            let checks = checks.flat_map(|profile| {
                let report = representation.check(&rows, profile, statistics.as_ref());
                let failed = report.checks.into_iter().filter(|check| !check.passed);
                failed.map(move |check| {
                    let (name, message, allowed) = (check.name, check.message, check.threshold);
                    format!("fails the {profile} check {name}: {message}, {allowed} allowed")
                })
            });
            let problems = representation.implausible(&rows).into_iter().chain(checks);
            let problems = problems.map(|problem| (item.id().to_owned(), problem));
            problems.collect::<Vec<_>>()
        };
        let take = |failed: Vec<_>| problems.extend(failed.into_iter().map(problem(false)));
        side.measure_among(failed, take, &no_progress, &Alone)?;
    }
    problems.sort_by(|a, b| a.id.cmp(&b.id));
    let beats = all.as_mut().map(|all| std::mem::take(&mut all.beats));
    let beats = beats.and_then(BeatAgreement::of);
    if let Some(beats) = beats.filter(|beats| beats.is_at_chance()) {
        warnings.push(format!(
            "the phase of the phrases does not follow the beats tracked in their music: {beats}"
        ));
    }
    let frames: usize = lengths.iter().sum();
    let moments = all.as_ref().map(|all| all.motion.moments());
    let groups = moments.map(|moments| {
        let groups = representation.groups().into_iter();
        groups
            .map(|(name, channels)| ChannelSummary::of(&name, moments, channels))
            .collect()
    });
    let conditions = all.iter().flat_map(|all| &all.conditions);
    Ok(Inspection {
        source,
        kind,
        representation: representation.name(),
        items: lengths.len(),
        bad_items,
        left_out: left_out.len(),
        train: train.len(),
        validation: validation.len(),
        frames,
        hours: frames as f64 / representation.fps() / 3600.0,
        fps: representation.fps(),
        shortest_frames: lengths.iter().copied().min().unwrap_or(0),
        longest_frames: lengths.iter().copied().max().unwrap_or(0),
        channels: representation.channels(),
        motion: groups.unwrap_or_default(),
        conditions: conditions
            .map(|(name, moments)| ChannelSummary::of(name, moments, 0..1))
            .collect(),
        counts: all.map(|all| all.counts).unwrap_or_default(),
        beats,
        problems,
        warnings,
    })
}

#[cfg(test)]
mod tests;
