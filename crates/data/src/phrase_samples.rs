//! From phrases to samples: passage, crop, augmentation, normalisation.

use std::sync::Arc;

use kinegrad_motion::{CHANNELS, Statistics};

use crate::augment::Augmentation;
use crate::batch::{AUDIO, ConditionRows, SampleShape};
use crate::loader::Samples;
use crate::passage::{Passage, Passages};
use crate::{Batch, DataConfig, Error, Phrase, PhraseSet};

/// Samples of phrases, conditioned on audio.
#[derive(Clone, Debug)]
pub struct PhraseSamples {
    passages: Passages,
    statistics: Arc<Statistics>,
    sampler: Augmentation,
    target_frames: usize,
    audio_channels: usize,
}

impl PhraseSamples {
    /// Samples of `phrases`, normalised by `statistics`, cropped and augmented as `config` says
    /// with draws of this `seed`.
    pub fn new(
        phrases: PhraseSet,
        statistics: Arc<Statistics>,
        config: &DataConfig,
        seed: u64,
    ) -> Self {
        Self {
            passages: Passages::new(phrases, config.target_frames, config.join_neighbours),
            statistics,
            sampler: Augmentation::new(config, seed),
            target_frames: config.target_frames,
            audio_channels: config.audio_layout().channels(),
        }
    }
}

impl Samples for PhraseSamples {
    type Item = Phrase;
    type Read = Passage;

    fn items(&self) -> &PhraseSet {
        self.passages.phrases()
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: CHANNELS,
            frames: self.target_frames,
            conditions: vec![(AUDIO, self.audio_channels, self.target_frames)],
        }
    }

    fn is_at_hand(&self, position: usize) -> bool {
        self.passages.is_at_hand(position)
    }

    fn read(&self, position: usize) -> Result<Passage, Error> {
        self.passages.get(position)
    }

    /// Validation takes the leading crop, without augmentation.
    fn push(&self, batch: &mut Batch, passage: &Passage, number: Option<u64>) {
        let (motion, audio) = match number {
            Some(n) => self.sampler.windows(passage, n),
            None => {
                let length = passage.own.len().min(self.target_frames);
                passage.window(passage.own.start..passage.own.start + length)
            }
        };
        let rows = motion.frames.start * CHANNELS..motion.frames.end * CHANNELS;
        let heard = ConditionRows {
            values: audio.of.as_slice(),
            frames: audio.of.frames(),
            range: audio.frames,
        };
        let rows = &motion.of.as_slice()[rows];
        batch.push(&passage.id, rows, &self.statistics, &[heard]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::AUDIO_CHANNELS;
    use crate::synthetic;
    use kinegrad_motion::phrase_statistics;

    #[test]
    fn validation_cuts_pads_and_masks_phrases() {
        let phrases: Vec<Arc<Phrase>> = [9, 5]
            .map(|frames| Arc::new(synthetic::phrase(frames, frames, 2)))
            .to_vec();
        let statistics = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
        let mut config = DataConfig {
            target_frames: 7,
            ..DataConfig::default()
        };
        config.augment.mirror = true;
        let given = Arc::new(statistics.clone());
        let samples = PhraseSamples::new(phrases.clone().into(), given, &config, 3);
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
