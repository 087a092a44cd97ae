//! Conversion of clips to samples: caption, range, crop, root, normalization.

use std::borrow::Cow;
use std::sync::Arc;

use kinegrad_motion::humanml::TEXT_CHANNELS;
use kinegrad_motion::metrics::text_motion::{MAX_WORDS, PartOfSpeech, WordVectors};
use kinegrad_motion::path::Bend;
use kinegrad_motion::{JointFeatures, Representation, Statistics};
use kinegrad_random::{Key, Purpose};

use crate::batch::{CAPTIONS, ConditionRows, SampleShape, TEXT, WORDS};
use crate::loader::Samples;
use crate::{Batch, Crop, DataConfig, Error};

use super::clip::NO_EMBEDDING;
use super::{Caption, CaptionLabels, Clip, ClipSet};

/// Samples of clips with a condition on a caption. Lengths are multiples of `unit_frames` if
/// possible.
#[derive(Clone, Debug)]
pub struct ClipSamples {
    clips: ClipSet,
    representation: JointFeatures,
    statistics: Arc<Statistics>,
    channels: usize,
    target_frames: usize,
    unit_frames: usize,
    crop: Crop,
    path_warp_prob: f64,
    labels: Option<CaptionLabels>,
    seed: u64,
    words: Option<Arc<WordVectors>>,
}

impl ClipSamples {
    /// Samples of the first `channels` features of `clips`, normalized by `statistics` and cropped
    /// by `config` and `seed`. Panics if `statistics` or `channels` do not match `representation`.
    pub fn new(
        clips: ClipSet,
        representation: JointFeatures,
        statistics: Arc<Statistics>,
        channels: usize,
        config: &DataConfig,
        seed: u64,
    ) -> Self {
        let all = representation.channels();
        assert_eq!(statistics.channels(), all, "another skeleton");
        assert_eq!(statistics.root, Some(representation.root), "another root");
        assert!(
            (1..=all).contains(&channels),
            "{channels} of {all} channels"
        );
        Self {
            clips,
            representation,
            statistics,
            channels,
            target_frames: config.target_frames,
            unit_frames: config.humanml3d.unit_frames,
            crop: config.crop,
            path_warp_prob: config.augment.path_warp_prob,
            labels: None,
            seed,
            words: None,
        }
    }

    /// Replaces embeddings by the [`WORDS`] of captions, and adds [`CAPTIONS`].
    #[must_use]
    pub fn with_words(self, words: Arc<WordVectors>) -> Self {
        Self {
            words: Some(words),
            ..self
        }
    }

    /// Conditions on the index of the caption in `labels`; other captions give zeros.
    #[must_use]
    pub fn with_labels(self, labels: CaptionLabels) -> Self {
        Self {
            labels: Some(labels),
            ..self
        }
    }

    /// The random bend of training sample `n`, if any.
    fn bend(&self, n: u64) -> Option<Bend> {
        let key = Key::new(self.seed, Purpose::Augment).at(n);
        let bends = key.named("path_warp").uniform() < self.path_warp_prob;
        bends.then(|| Bend::random(key.named("bend")))
    }

    /// Channels of the caption condition.
    fn text_channels(&self) -> usize {
        let labels = self.labels.as_ref();
        labels.map_or(TEXT_CHANNELS, |labels| labels.captions().len())
    }
}

impl Samples for ClipSamples {
    type Item = Clip;
    type Read = Arc<Clip>;

    fn items(&self) -> &ClipSet {
        &self.clips
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: self.channels,
            frames: self.target_frames,
            conditions: match &self.words {
                Some(words) => vec![(WORDS, words.width() + 1, MAX_WORDS + 2), (CAPTIONS, 1, 1)],
                None => vec![(TEXT, self.text_channels(), 1)],
            },
        }
    }

    fn read(&self, position: usize) -> Result<Arc<Clip>, Error> {
        self.clips.get(position)
    }

    /// Validation uses the first caption and the leading crop. Samples begin at the origin and face
    /// +z.
    fn push(&self, batch: &mut Batch, clip: &Arc<Clip>, number: Option<u64>) {
        let below = |bound, purpose| {
            number.map_or(0, |n| {
                Key::new(self.seed, purpose).at(n).integers(1, bound)[0]
            })
        };
        let caption = match clip.captions.len() {
            0 => None,
            captions => Some(&clip.captions[below(captions, Purpose::Caption)]),
        };
        let frames = clip.features.frames();
        let caption_range = caption.map_or(0..frames, |caption| {
            caption.frames(frames, self.representation.fps())
        });
        // The reader drops short ranges, but clips in memory may have ranges of any length.
        let caption_range = match caption_range.is_empty() {
            true => 0..frames,
            false => caption_range,
        };
        let most = caption_range.len().min(self.target_frames);
        let length = match most - most % self.unit_frames {
            0 => most,
            length => length,
        };
        let first = caption_range.start
            + match self.crop {
                Crop::Random => below(caption_range.len() - length + 1, Purpose::Crop),
                Crop::Leading => 0,
            };
        let skeleton = &self.representation.skeleton;
        let features = clip.features.crop(skeleton, first..first + length);
        let features = features.expect("the reader takes features of this skeleton alone");
        let bend = number.and_then(|n| self.bend(n));
        // A single frame has no trajectory to bend.
        let bent = bend.and_then(|bend| bend.of_features(&features, skeleton).ok());
        let features = bent.unwrap_or(features);
        let features = features.with_root(self.representation.root);
        let values;
        let same = [self.words.as_ref().map_or(0.0, |_| captions_number(clip))];
        let text = match (&self.words, &self.labels) {
            (Some(vectors), _) => {
                let tokens = caption.map(Caption::words).unwrap_or_default();
                let sentence = vectors.sentence(&tokens);
                values = by_channel(&sentence, vectors.width());
                ConditionRows::all(&values, sentence.len())
            }
            (None, Some(labels)) => {
                let row = caption.and_then(|caption| labels.row(&caption.text));
                values = labels.values(row);
                ConditionRows::all(&values, 1)
            }
            (None, None) => {
                let embedding = caption.and_then(|caption| caption.embedding.as_deref());
                ConditionRows::all(embedding.unwrap_or(&NO_EMBEDDING), 1)
            }
        };
        let conditions = [text, ConditionRows::all(&same, 1)];
        let conditions = match self.words {
            Some(_) => &conditions[..],
            None => &conditions[..1],
        };
        batch.push(&clip.id, features.as_slice(), &self.statistics, conditions);
    }
}

/// A 24-bit number, exact as a float, that is equal for clips with the same captions.
fn captions_number(clip: &Clip) -> f32 {
    let texts = clip.captions.iter().map(|caption| caption.text.as_str());
    let texts = texts.collect::<Vec<_>>().join("\n");
    let number = Key::new(0, Purpose::WordVectors).named(&texts).seed();
    (number & 0xff_ffff) as f32
}

/// The words of a sentence as [`WORDS`].
fn by_channel(sentence: &[(Cow<'_, [f32]>, PartOfSpeech)], width: usize) -> Vec<f32> {
    let vectors = (0..width).flat_map(|channel| sentence.iter().map(move |(of, _)| of[channel]));
    let classes = sentence
        .iter()
        .map(|(_, class)| (*class as usize + 1) as f32);
    vectors.chain(classes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk;
    use crate::{DataKind, Dataset, Loader};
    use kinegrad_motion::humanml::{Features, Root};
    use kinegrad_motion::representation::statistics_of;
    use std::collections::BTreeSet;

    fn config() -> DataConfig {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            target_frames: 50,
            batch_size: 3,
            num_workers: 0,
            ..DataConfig::default()
        };
        config.synthetic.phrases = 7;
        config.synthetic.frames = 90;
        config
    }

    fn samples(config: &DataConfig, channels: usize) -> ClipSamples {
        let dataset = Dataset::open(config).unwrap();
        let statistics = Arc::new(dataset.statistics().unwrap());
        let Dataset {
            train,
            representation,
            ..
        } = dataset;
        ClipSamples::new(train, representation, statistics, channels, config, 1)
    }

    fn batches(config: &DataConfig, channels: usize, first: u64, n: usize) -> Vec<Batch> {
        let mut loader = Loader::new(samples(config, channels), config, 1, first);
        (0..n).map(|_| loader.next().unwrap()).collect()
    }

    #[test]
    fn batches_are_the_same_with_any_number_of_workers_and_from_any_start() {
        let with = |num_workers, memory_mib| {
            let mut config = config();
            config.num_workers = num_workers;
            config.cache.memory_mib = memory_mib;
            config
        };
        let expected = batches(&with(0, 1024), 263, 0, 9);
        assert_eq!(batches(&with(3, 1024), 263, 0, 9), expected);
        assert_eq!(batches(&with(1, 1024), 263, 5, 4), expected[5..]);
        assert_eq!(batches(&with(0, 0), 263, 5, 4), expected[5..]);
        assert!(expected.iter().zip(&expected[1..]).all(|(a, b)| a != b));
    }

    #[test]
    fn samples_are_whole_units_and_the_rest_is_padding() {
        let batch = &batches(&config(), 263, 0, 1)[0];
        assert_eq!((batch.channels, batch.frames), (263, 50));
        assert_eq!(batch.conditions[0].values.len(), 3 * 512);
        for sample in 0..3 {
            let mask = &batch.mask[50 * sample..][..50];
            assert!(mask[..48].iter().all(|&value| value == 1.0));
            assert_eq!(mask[48..], [0.0, 0.0]);
            for channel in 0..263 {
                let row = &batch.x_start[(sample * 263 + channel) * 50..][..50];
                assert_eq!(row[48..], [0.0, 0.0]);
            }
            let condition = &batch.conditions[0].values[512 * sample..][..512];
            let square: f32 = condition.iter().map(|value| value * value).sum();
            assert!((square - 1.0).abs() < 1e-4, "{square}");
        }
    }

    #[test]
    fn crops_are_anchored_at_the_origin_and_are_those_of_their_clip() {
        for root in [Root::Absolute, Root::Relative] {
            let mut config = config();
            config.humanml3d.root = root;
            let dataset = Dataset::<Clip>::open(&config).unwrap();
            let statistics = dataset.statistics().unwrap();
            let skeleton = dataset.representation.skeleton.clone();
            let mut starts = BTreeSet::new();
            for batch in batches(&config, 263, 0, 6) {
                for sample in 0..3 {
                    // A caption range may be shorter than the crop.
                    let mask = &batch.mask[50 * sample..][..50];
                    let valid = mask.iter().filter(|&&value| value == 1.0).count();
                    assert!(valid >= 40 && valid % 4 == 0, "{valid}");
                    let rows = &batch.x_start[sample * 263 * 50..][..263 * 50];
                    let values = rows.chunks(50).flat_map(|row| &row[..valid]).copied();
                    let values: Vec<f32> = values.collect();
                    let found = statistics.denormalize(&values);
                    if root == Root::Absolute {
                        let first = &found[..3];
                        assert!(first.iter().all(|value| value.abs() < 1e-6), "{first:?}");
                    }
                    let part = Features::new(found, skeleton.layout(), root).unwrap();
                    let by_rotations = part.joints_from_rotations(&skeleton).unwrap();
                    let pairs = by_rotations
                        .to_f32()
                        .into_iter()
                        .zip(part.joints().to_f32());
                    let apart = pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()));
                    assert!(apart < 1e-3, "{root}: rotations lead {apart} m elsewhere");
                    let clip = dataset.find(&batch.ids[sample]).unwrap().unwrap();
                    let normalized = |start: usize| {
                        let part = clip.features.crop(&skeleton, start..start + valid);
                        statistics.normalize(part.unwrap().with_root(root).as_slice())
                    };
                    let start = (0..=90 - valid).find(|&start| normalized(start) == values);
                    starts.insert(start.expect("a window of the clip"));
                }
            }
            assert!(starts.len() > 8, "{starts:?}");
        }
    }

    #[test]
    fn trajectories_are_bent_with_the_given_probability() {
        for root in [Root::Absolute, Root::Relative] {
            let with = |path_warp_prob| {
                let mut config = config();
                config.humanml3d.root = root;
                config.augment.path_warp_prob = path_warp_prob;
                config
            };
            let (plain, half) = (with(0.0), with(0.5));
            let dataset = Dataset::<Clip>::open(&plain).unwrap();
            let statistics = dataset.statistics().unwrap();
            let skeleton = dataset.representation.skeleton;
            let pairs = batches(&plain, 263, 0, 20).into_iter();
            let pairs = pairs.zip(batches(&half, 263, 0, 20));
            let (mut bent, mut turned) = (0, 0);
            for (plain, half) in pairs {
                assert_eq!(
                    (&plain.mask, &plain.conditions),
                    (&half.mask, &half.conditions)
                );
                for sample in 0..3 {
                    let valid = plain.mask[50 * sample..][..50].iter().sum::<f32>() as usize;
                    let features = |batch: &Batch| {
                        let rows = &batch.x_start[sample * 263 * 50..][..263 * 50];
                        let values = rows.chunks(50).flat_map(|row| &row[..valid]).copied();
                        let values = statistics.denormalize(&values.collect::<Vec<_>>());
                        Features::new(values, skeleton.layout(), root).unwrap()
                    };
                    let (before, after) = (features(&plain), features(&half));
                    if before.as_slice() == after.as_slice() {
                        continue;
                    }
                    bent += 1;
                    let heading = |features: &Features| {
                        let facing = features.root_quaternions();
                        let last = facing[valid - 1];
                        2.0 * last.y.atan2(last.w)
                    };
                    turned += usize::from((heading(&before) - heading(&after)).abs() > 0.2);
                    let first = after.joints().frame(0)[0];
                    assert!(first[0].hypot(first[2]) < 1e-4, "{first:?}");
                    let (a, b) = (after.joints_from_rotations(&skeleton), after.joints());
                    let pairs = a.unwrap().to_f32().into_iter().zip(b.to_f32());
                    let apart = pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()));
                    assert!(apart < 2e-3, "{root}: rotations lead {apart} m elsewhere");
                }
            }
            assert!((18..42).contains(&bent), "{bent} of 60");
            assert!(turned * 2 > bent, "{turned} of {bent} turn");
            let validation = |config: &DataConfig| {
                let all = samples(config, 263);
                let count = all.clips.load().unwrap().len();
                all.collate(0..count).unwrap()
            };
            assert_eq!(validation(&plain), validation(&half));
        }
    }

    #[test]
    fn the_first_channels_alone_are_those_of_all() {
        let (all, few) = (batches(&config(), 263, 0, 2), batches(&config(), 4, 0, 2));
        for (all, few) in all.iter().zip(&few) {
            assert_eq!((few.channels, few.x_start.len()), (4, 3 * 4 * 50));
            for sample in 0..3 {
                let part = &all.x_start[sample * 263 * 50..][..4 * 50];
                assert_eq!(&few.x_start[sample * 4 * 50..][..4 * 50], part);
            }
            assert_eq!((&all.conditions, &all.mask), (&few.conditions, &few.mask));
        }
    }

    #[test]
    fn every_caption_comes_up_with_its_own_range() {
        let mut config = config();
        config.batch_size = 64;
        let clip = (0..40).map(|index| walk(index, 90, 3));
        let mut clip = clip.filter(|clip| clip.captions.len() == 4);
        let mut clip = clip.next().expect("a walk that turns");
        // Each caption range allows one start, which identifies the caption.
        for (caption, seconds) in clip.captions.iter_mut().zip([
            None,
            Some((0.0, 2.0)),
            Some((1.0, 3.0)),
            Some((2.0, 4.0)),
        ]) {
            caption.seconds = seconds;
        }
        let representation = samples(&config, 263).representation;
        let features: Vec<_> = [(0, 40), (20, 60), (40, 80)]
            .map(|(from, to)| clip.features.crop(&representation.skeleton, from..to))
            .map(|features| features.unwrap().to_absolute())
            .to_vec();
        let rows = features.iter().map(Features::as_slice);
        let statistics = Arc::new(statistics_of(&representation, rows).unwrap());
        let clips = ClipSet::from(vec![Arc::new(clip.clone())]);
        let samples = ClipSamples::new(clips, representation, statistics.clone(), 263, &config, 1);
        let mut loader = Loader::new(samples, &config, 1, 0);
        let batch = loader.next().unwrap();
        let mut seen = [0; 4];
        for sample in 0..64 {
            let condition = &batch.conditions[0].values[512 * sample..][..512];
            let caption = clip
                .captions
                .iter()
                .position(|caption| caption.embedding.as_deref() == Some(condition));
            let caption = caption.expect("an embedding of the clip");
            seen[caption] += 1;
            if let Some(part) = caption.checked_sub(1) {
                let expected = statistics.normalize(features[part].as_slice());
                let rows = &batch.x_start[sample * 263 * 50..][..263 * 50];
                let found: Vec<f32> = rows.chunks(50).flat_map(|row| row[..40].to_vec()).collect();
                assert_eq!(found, expected);
            }
        }
        assert!(seen.iter().all(|&count| count > 6), "{seen:?}");
    }

    #[test]
    fn words_of_captions_fill_their_places() {
        let config = config();
        let vectors = Arc::new(WordVectors::random(6));
        let all = samples(&config, 263).with_words(vectors.clone());
        let clips = all.clips.load().unwrap();
        let batch = all.collate(0..clips.len()).unwrap();
        let words = &batch.conditions[0];
        assert_eq!((words.name, words.channels, words.frames), (WORDS, 7, 22));
        let same = &batch.conditions[1];
        assert_eq!((same.name, same.channels, same.frames), (CAPTIONS, 1, 1));
        let texts = |clip: &Clip| {
            clip.captions
                .iter()
                .map(|c| c.text.clone())
                .collect::<Vec<_>>()
        };
        let mut alike = 0;
        for (a, first) in clips.iter().zip(&same.values) {
            for (b, second) in clips.iter().zip(&same.values) {
                assert_eq!(first == second, texts(a) == texts(b));
                alike += usize::from(first == second);
            }
        }
        assert!(alike < clips.len().pow(2), "clips with other captions");
        let mut lengths = BTreeSet::new();
        for (clip, rows) in clips.iter().zip(words.values.chunks(7 * 22)) {
            let sentence = vectors.sentence(&clip.captions[0].words());
            lengths.insert(sentence.len());
            for place in 0..22 {
                let of_word: Vec<f32> = rows.chunks(22).map(|row| row[place]).collect();
                match sentence.get(place) {
                    Some((vector, class)) => {
                        assert_eq!(of_word[..6], vector[..]);
                        assert_eq!(of_word[6], (*class as usize + 1) as f32);
                    }
                    None => assert_eq!(of_word, [0.0; 7]),
                }
            }
        }
        assert!(
            lengths.len() > 1,
            "captions of different lengths: {lengths:?}"
        );
    }

    #[test]
    fn validation_takes_the_first_caption_and_the_leading_crop() {
        let config = config();
        let all = samples(&config, 263);
        let clips = all.clips.load().unwrap();
        let batch = all.collate(0..clips.len()).unwrap();
        assert_eq!(batch.batch_size, clips.len());
        let first = clips[1].features.slice(0..48).to_absolute();
        let rows = &batch.x_start[263 * 50..][..263 * 50];
        let found: Vec<f32> = rows.chunks(50).flat_map(|row| row[..48].to_vec()).collect();
        assert_eq!(found, all.statistics.normalize(first.as_slice()));
        let embedding = clips[1].captions[0].embedding.as_deref();
        assert_eq!(Some(&batch.conditions[0].values[512..1024]), embedding);

        let mut bare = (*clips[0]).clone();
        bare.captions.clear();
        let one = ClipSamples {
            clips: vec![Arc::new(bare)].into(),
            ..all
        };
        let batch = one.collate(0..1).unwrap();
        assert_eq!(batch.conditions[0].values, [0.0; 512]);
    }
}
