//! Conversion of phrases to samples: context, crop, augmentation, normalization.

use std::sync::Arc;

use kinegrad_motion::{CHANNELS, ChannelEncoding, ChannelMoments, Phrase, Statistics};
use kinegrad_ranks::Sharing;

use crate::augment::Augmentation;
use crate::batch::{AUDIO, ConditionRows, SampleShape};
use crate::context_window::{ContextWindow, ContextWindows, Window};
use crate::item_set::measure_among;
use crate::loader::Samples;
use crate::progress::no_progress;
use crate::{
    Batch, DataConfig, Error, PhraseItem, PhraseSet, StatisticsOf, StyleConditions, mean_style,
};

/// Number of crops per phrase for statistics.
const CROPS: u64 = 8;

/// Samples of phrases, conditioned on audio.
#[derive(Clone, Debug)]
pub struct PhraseSamples {
    contexts: ContextWindows,
    statistics: Arc<Statistics>,
    sampler: Augmentation,
    target_frames: usize,
    targets: ChannelEncoding,
    audio_channels: usize,
    style: StyleConditions,
}

impl PhraseSamples {
    /// Samples of `phrases`, normalized by `statistics` and augmented by `config` and `seed`.
    pub fn new(
        phrases: PhraseSet,
        statistics: Arc<Statistics>,
        config: &DataConfig,
        seed: u64,
    ) -> Self {
        let sampler = Augmentation::new(config, seed);
        Self {
            contexts: ContextWindows::new(phrases, sampler.frames_seen(), config.join_neighbours),
            statistics,
            sampler,
            target_frames: config.target_frames,
            targets: ChannelEncoding::default(),
            audio_channels: config.audio_layout().channels(),
            style: StyleConditions::default(),
        }
    }

    /// Adds style conditions: the mean of the sample's style channels, and the phrase's label.
    #[must_use]
    pub fn with_style(self, style: StyleConditions) -> Self {
        Self { style, ..self }
    }

    /// Encodes the samples by `targets`; `statistics` must use the same channels.
    #[must_use]
    pub fn with_targets(self, targets: ChannelEncoding) -> Self {
        Self { targets, ..self }
    }
}

/// Statistics of `phrases` (at least one) in the channels of `targets`, measured on whole phrases
/// or training crops, by `config`. Each rank measures a part of the phrases. Collective. Fails as
/// [`ItemSet::measure_among`](crate::ItemSet::measure_among).
pub fn target_statistics(
    phrases: PhraseSet,
    targets: ChannelEncoding,
    config: &DataConfig,
    sharing: &dyn Sharing<Error>,
) -> Result<Statistics, Error> {
    // All runs use the same crops, so losses are comparable.
    let sampler = Augmentation::new(config, 0);
    let contexts = ContextWindows::new(phrases, sampler.frames_seen(), config.join_neighbours);
    let measure = |position: usize| -> Result<ChannelMoments, Error> {
        let context = contexts.get(position)?;
        let encoded = |window: Window<'_, Phrase>| {
            let rows = window.frames.start * CHANNELS..window.frames.end * CHANNELS;
            targets.encode(&window.of.as_slice()[rows]).into_owned()
        };
        let samples: Vec<Vec<f32>> = match config.statistics {
            StatisticsOf::Phrases => vec![encoded(context.leading(context.own.len()).0)],
            StatisticsOf::Crops => (0..CROPS)
                .map(|crop| encoded(sampler.windows(&context, position as u64 * CROPS + crop).0))
                .collect(),
        };
        let samples = samples.iter().map(Vec::as_slice);
        let mut moments = ChannelMoments::measure(targets.channels(), samples);
        moments.items = 1;
        Ok(moments)
    };
    let mut all: Option<ChannelMoments> = None;
    let take = |moments| match &mut all {
        Some(all) => all.merge(&moments),
        None => all = Some(moments),
    };
    let phrases = contexts.phrases();
    let owner = |position| phrases.number(position);
    measure_among(phrases.len(), owner, measure, take, &no_progress, sharing)?;
    Ok(targets.statistics(all.expect("at least one phrase")))
}

impl Samples for PhraseSamples {
    type Item = PhraseItem;
    type Read = ContextWindow;

    fn items(&self) -> &PhraseSet {
        self.contexts.phrases()
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: self.targets.channels(),
            frames: self.target_frames,
            conditions: {
                let style = self.style.shapes().into_iter();
                let style = style.map(|(name, values)| (name, values, 1));
                let audio = (AUDIO, self.audio_channels, self.target_frames);
                [audio].into_iter().chain(style).collect()
            },
        }
    }

    fn is_cached(&self, position: usize) -> bool {
        self.contexts.is_cached(position)
    }

    fn read(&self, position: usize) -> Result<ContextWindow, Error> {
        self.contexts.get(position)
    }

    /// Validation uses the leading crop, without augmentation.
    fn push(&self, batch: &mut Batch, context: &ContextWindow, number: Option<u64>) {
        let (motion, audio) = match number {
            Some(n) => self.sampler.windows(context, n),
            None => context.leading(self.target_frames),
        };
        let rows = motion.frames.start * CHANNELS..motion.frames.end * CHANNELS;
        let audio_rows = ConditionRows {
            values: audio.of.as_slice(),
            frames: audio.of.frames(),
            range: audio.frames,
        };
        let rows = &motion.of.as_slice()[rows];
        let numbers = Some(mean_style(rows));
        let style = self.style.values(numbers, context.take.label.as_deref());
        let style = style.iter().map(|values| ConditionRows::all(values, 1));
        let conditions: Vec<ConditionRows<'_>> = [audio_rows].into_iter().chain(style).collect();
        let rows = self.targets.encode(rows);
        batch.push(&context.id, &rows, &self.statistics, &conditions);
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_ranks::Alone;

    use super::*;
    use crate::audio_layout::AUDIO_CHANNELS;
    use crate::synthetic;
    use kinegrad_motion::phrase_statistics;

    fn phrases(frames: [usize; 2]) -> PhraseSet {
        let phrase = |frames| Arc::new(synthetic::phrase(frames, frames, 2));
        frames.map(phrase).to_vec().into()
    }

    #[test]
    fn samples_hold_the_targets_in_place_of_phase_and_quaternion() {
        use kinegrad_motion::{OrientationEncoding, PhaseEncoding};

        let targets = ChannelEncoding {
            phase: PhaseEncoding::SinCos,
            orientation: OrientationEncoding::Rotation6d,
        };
        let config = DataConfig {
            target_frames: 7,
            ..DataConfig::default()
        };
        let phrases = phrases([9, 5]);
        let statistics = target_statistics(phrases.clone(), targets, &config, &Alone).unwrap();
        assert_eq!((statistics.channels(), statistics.items), (28, 2));
        let shared = Arc::new(statistics.clone());
        let samples = PhraseSamples::new(phrases.clone(), shared, &config, 3).with_targets(targets);
        let batch = samples.collate(0..2).unwrap();
        assert_eq!((batch.batch_size, batch.channels, batch.frames), (2, 28, 7));
        assert_eq!(batch.x_start.len(), 2 * 28 * 7);
        for sample in 0..2 {
            let phrase = phrases.get(sample).unwrap();
            let frames = phrase.frames().min(7);
            let found = &batch.x_start[sample * 28 * 7..][..28 * 7];
            let valid = found.chunks(7).flat_map(|row| row[..frames].to_vec());
            let rows = statistics.denormalize(&valid.collect::<Vec<_>>());
            let back = Phrase::new(targets.decode(rows)).unwrap();
            for t in 0..frames {
                let dot = back.quaternion(t).dot(phrase.motion.quaternion(t));
                assert!((dot.abs() - 1.0).abs() < 1e-5);
                let pairs = back.frame(t)[..9].iter().zip(&phrase.motion.frame(t)[..9]);
                assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-4));
            }
            assert!(
                found
                    .chunks(7)
                    .all(|row| row[frames..].iter().all(|v| *v == 0.0))
            );
        }
    }

    #[test]
    fn samples_say_their_own_style_and_label() {
        let config = DataConfig {
            target_frames: 7,
            ..DataConfig::default()
        };
        let labels = [Some("waltz"), None, Some("tango"), Some("rumba")];
        let phrases: Vec<Arc<PhraseItem>> = (0..4)
            .map(|index| {
                Arc::new(PhraseItem {
                    label: labels[index].map(str::to_owned),
                    ..synthetic::phrase(index, 5 + 2 * index, 2)
                })
            })
            .collect();
        let statistics = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
        // An unknown label counts as no label.
        let known = ["rumba", "waltz"].map(str::to_owned).to_vec();
        let style = StyleConditions::default()
            .with_numbers(&statistics)
            .with_labels(known);
        let set: PhraseSet = phrases.clone().into();
        assert_eq!(
            set.labels().into_iter().collect::<Vec<_>>(),
            ["rumba", "tango", "waltz"]
        );
        let shared = Arc::new(statistics.clone());
        let samples = PhraseSamples::new(set, shared, &config, 3);
        let plain = samples.collate(0..4).unwrap();
        let batch = samples.with_style(style).collate(0..4).unwrap();
        assert_eq!(
            (&plain.x_start, plain.conditions.len()),
            (&batch.x_start, 1)
        );
        let of_labels = batch.condition(crate::LABEL).unwrap();
        assert_eq!(of_labels.values, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let numbers = batch.condition(crate::STYLE).unwrap();
        assert_eq!((numbers.channels, numbers.frames), (9, 1));
        for (sample, found) in numbers.values.chunks(9).enumerate() {
            let frames = phrases[sample].frames().min(7);
            for (i, &value) in found[..8].iter().enumerate() {
                // The expected value is the mean of the sample's normalized frames.
                let row = &batch.x_start[(sample * CHANNELS + 17 + i) * 7..][..frames];
                let mean = row.iter().sum::<f32>() / frames as f32;
                assert!((value - mean).abs() < 1e-4, "{sample} {i}: {value} {mean}");
            }
            assert_eq!(found[8], 1.0);
        }
    }

    #[test]
    fn statistics_of_crops_are_those_of_what_training_sees() {
        let targets = ChannelEncoding::default();
        let mut config = DataConfig {
            target_frames: 10,
            ..DataConfig::default()
        };
        let set = phrases([60, 45]);
        let whole = target_statistics(set.clone(), targets, &config, &Alone).unwrap();
        let items = set.load().unwrap();
        let stored = phrase_statistics(items.iter().map(|item| &item.motion)).unwrap();
        for channel in 0..CHANNELS {
            assert!((whole.mean[channel] - stored.mean[channel]).abs() < 1e-9);
            assert!((whole.std[channel] - stored.std[channel]).abs() < 1e-9);
        }
        config.statistics = StatisticsOf::Crops;
        let crops = target_statistics(set.clone(), targets, &config, &Alone).unwrap();
        assert_eq!(
            target_statistics(set.clone(), targets, &config, &Alone).unwrap(),
            crops
        );
        // Only the statistics of crops give training samples with zero mean and unit deviation.
        let deviation = |statistics: &Statistics| {
            let shared = Arc::new(statistics.clone());
            let samples = PhraseSamples::new(set.clone(), shared, &config, 11);
            let mut batch = Batch::with_capacity(400, &samples.shape());
            for number in 0..400 {
                let read = samples.read(number as usize % 2).unwrap();
                samples.push(&mut batch, &read, Some(number));
            }
            let x = batch
                .x_start
                .chunks(CHANNELS * 10)
                .flat_map(|sample| &sample[..10]);
            let x: Vec<f64> = x.map(|&value| f64::from(value)).collect();
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / x.len() as f64).sqrt()
        };
        assert!(
            (deviation(&crops) - 1.0).abs() < 0.15,
            "{}",
            deviation(&crops)
        );
        assert!(
            (deviation(&whole) - 1.0).abs() > 0.3,
            "{}",
            deviation(&whole)
        );
    }

    #[test]
    fn validation_sees_a_phrase_as_it_is_whatever_it_is_joined_with() {
        let whole = synthetic::phrase(0, 90, 4);
        let phrases: Vec<Arc<PhraseItem>> = (0..3)
            .map(|i| {
                let frames = 30 * i..30 * (i + 1);
                let mut motion = whole.motion.slice(frames.clone());
                kinegrad_motion::anchor_floor(&mut motion);
                Arc::new(PhraseItem {
                    id: format!("song_{:05}", 30 * i),
                    motion,
                    audio: whole.audio.slice(frames),
                    label: None,
                })
            })
            .collect();
        let statistics = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
        let statistics = Arc::new(statistics);
        let batch = |joined: bool| {
            let config = DataConfig {
                target_frames: 25,
                join_neighbours: joined,
                ..DataConfig::default()
            };
            let samples =
                PhraseSamples::new(phrases.clone().into(), statistics.clone(), &config, 3);
            samples.collate(0..3).unwrap()
        };
        let (alone, joined) = (batch(false), batch(true));
        assert_eq!(alone.conditions[0].values, joined.conditions[0].values);
        for (a, b) in alone.x_start.iter().zip(&joined.x_start) {
            assert!((a - b).abs() < 1e-2, "{a} {b}");
        }
    }

    #[test]
    fn validation_cuts_pads_and_masks_phrases() {
        let phrases: Vec<Arc<PhraseItem>> = [9, 5]
            .map(|frames| Arc::new(synthetic::phrase(frames, frames, 2)))
            .to_vec();
        let statistics = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
        let mut config = DataConfig {
            target_frames: 7,
            ..DataConfig::default()
        };
        config.augment.mirror = true;
        let shared = Arc::new(statistics.clone());
        let samples = PhraseSamples::new(phrases.clone().into(), shared, &config, 3);
        let batch = samples.collate(0..2).unwrap();
        assert_eq!((batch.batch_size, batch.frames, batch.channels), (2, 7, 25));
        assert_eq!(batch.ids, ["synthetic_00009", "synthetic_00005"]);
        assert_eq!(batch.mask[7..], [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
        let audio = batch.condition(AUDIO).unwrap();
        for (sample, phrase) in phrases.iter().enumerate() {
            let frames = phrase.frames().min(7);
            let rows = statistics.normalize(&phrase.motion.as_slice()[..frames * CHANNELS]);
            for channel in 0..CHANNELS {
                let found = &batch.x_start[(sample * CHANNELS + channel) * 7..][..7];
                assert_eq!(found[..frames], rows[channel * frames..][..frames]);
                assert!(found[frames..].iter().all(|value| *value == 0.0));
            }
            for channel in 0..AUDIO_CHANNELS {
                let found = &audio.values[(sample * AUDIO_CHANNELS + channel) * 7..][..7];
                assert_eq!(found[..frames], phrase.audio.channel(channel)[..frames]);
                assert!(found[frames..].iter().all(|value| *value == 0.0));
            }
        }
        assert_eq!(samples.collate(0..0).unwrap().batch_size, 0);
    }
}
