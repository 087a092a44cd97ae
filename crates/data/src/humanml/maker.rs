//! From clips to batches: caption, passage, crop, root, normalisation.

use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::humanml::{FeatureStatistics, Root};
use kinegrad_random::{Key, Purpose};

use crate::batch::Shape;
use crate::loader::{MakeBatch, Samples};
use crate::{Batch, Crop, DataConfig, Error};

use super::clip::NO_EMBEDDING;
use super::{Caption, Clip, ClipSet, EMBEDDING_CHANNELS};

/// How a passage of a clip becomes a sample.
#[derive(Clone)]
struct Cutter {
    statistics: Arc<FeatureStatistics>,
    channels: Range<usize>,
    root: Root,
    fps: f64,
    target_frames: usize,
    unit_frames: usize,
}

impl Cutter {
    /// # Panics
    /// Panics unless `statistics` are of the configured skeleton and root, and have `channels`.
    fn new(
        statistics: Arc<FeatureStatistics>,
        channels: Range<usize>,
        config: &DataConfig,
    ) -> Self {
        let humanml3d = &config.humanml3d;
        let skeleton = humanml3d.skeleton.skeleton();
        assert_eq!(statistics.layout(), skeleton.layout(), "another skeleton");
        assert_eq!(statistics.root(), humanml3d.root, "another root");
        let all = 0..skeleton.layout().channels();
        assert!(
            channels.start < channels.end && channels.end <= all.end,
            "channels {channels:?} of {all:?}"
        );
        Self {
            statistics,
            channels,
            root: humanml3d.root,
            fps: skeleton.description().fps,
            target_frames: config.target_frames,
            unit_frames: humanml3d.unit_frames,
        }
    }

    fn shape(&self) -> Shape {
        Shape {
            channels: self.channels.len(),
            frames: self.target_frames,
            cond_channels: EMBEDDING_CHANNELS,
            cond_frames: 1,
        }
    }

    /// Adds a sample of `clip` that `caption` describes, as long as whole units allow; `start`
    /// picks its first frame, given how many there are to choose from.
    ///
    /// The relative features are cut and then converted, so that every sample begins at the origin
    /// facing +z.
    fn push(
        &self,
        batch: &mut Batch,
        clip: &Clip,
        caption: Option<&Caption>,
        start: impl FnOnce(usize) -> usize,
    ) {
        let frames = clip.features.frames();
        let passage = caption.map_or(0..frames, |caption| caption.frames(frames, self.fps));
        // The reader has left shorter passages out; held clips may be of any length.
        let passage = if passage.is_empty() {
            0..frames
        } else {
            passage
        };
        let most = passage.len().min(self.target_frames);
        let length = match most - most % self.unit_frames {
            0 => most,
            length => length,
        };
        let first = passage.start + start(passage.len() - length + 1);
        let features = clip.features.slice(first..first + length);
        let features = features.with_root(self.root);
        let (mean, std) = (self.statistics.mean(), self.statistics.std());
        let rows = self.channels.clone().map(|channel| {
            let (mean, std) = (mean[channel], std[channel]);
            let values = (0..length).map(|t| f64::from(features.frame(t)[channel]));
            values
                .map(move |value| ((value - mean) / std) as f32)
                .collect::<Vec<_>>()
        });
        let embedding = caption.and_then(|caption| caption.embedding.as_deref());
        let condition = embedding.unwrap_or(&NO_EMBEDDING).iter();
        batch.push(&clip.id, length, rows, condition.map(|&value| [value]));
    }
}

/// Makes training batches of clips. A clone makes the same batches.
#[derive(Clone)]
pub(crate) struct ClipMaker {
    clips: ClipSet,
    samples: Samples,
    cutter: Cutter,
    crop: Crop,
    seed: u64,
}

impl ClipMaker {
    /// The maker of a run with this `seed`.
    ///
    /// # Panics
    /// As [`Loader::clips`](crate::Loader::clips).
    pub fn new(
        clips: ClipSet,
        statistics: Arc<FeatureStatistics>,
        channels: Range<usize>,
        samples: Samples,
        config: &DataConfig,
        seed: u64,
    ) -> Self {
        Self {
            clips,
            samples,
            cutter: Cutter::new(statistics, channels, config),
            crop: config.crop,
            seed,
        }
    }
}

impl MakeBatch for ClipMaker {
    fn make(&mut self, number: u64) -> Result<Batch, Error> {
        let Self {
            clips,
            samples,
            cutter,
            crop,
            seed,
        } = self;
        samples.make(
            number,
            cutter.shape(),
            |position| clips.is_at_hand(position),
            |position| clips.get(position),
            |batch, n, clip| {
                let below = |bound, purpose| Key::new(*seed, purpose).at(n).integers(1, bound)[0];
                let caption = match clip.captions.len() {
                    0 => None,
                    captions => Some(&clip.captions[below(captions, Purpose::Caption)]),
                };
                cutter.push(batch, &clip, caption, |starts| match crop {
                    Crop::Random => below(starts, Purpose::Crop),
                    Crop::Leading => 0,
                });
            },
        )
    }
}

/// The clips as one batch, in their order: first caption, leading crop of whole units up to
/// `data.target_frames`, `channels` of the features with the configured root, normalised.
///
/// # Panics
/// Panics if `statistics` or `channels` are not of the configured layout and root.
pub fn collate_clips(
    clips: &[Arc<Clip>],
    statistics: &Arc<FeatureStatistics>,
    channels: Range<usize>,
    config: &DataConfig,
) -> Batch {
    let cutter = Cutter::new(statistics.clone(), channels, config);
    let mut batch = Batch::with_capacity(clips.len(), cutter.shape());
    for clip in clips {
        cutter.push(&mut batch, clip, clip.captions.first(), |_| 0);
    }
    batch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::{ClipDataset, walk};
    use crate::{DataKind, Loader};
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

    fn batches(config: &DataConfig, channels: Range<usize>, first: u64, n: usize) -> Vec<Batch> {
        let dataset = ClipDataset::open(config).unwrap();
        let statistics = Arc::new(dataset.statistics);
        let mut loader = Loader::clips(dataset.train, statistics, channels, config, 1, first);
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
        let expected = batches(&with(0, 1024), 0..263, 0, 9);
        assert_eq!(batches(&with(3, 1024), 0..263, 0, 9), expected);
        assert_eq!(batches(&with(1, 1024), 0..263, 5, 4), expected[5..]);
        assert_eq!(batches(&with(0, 0), 0..263, 5, 4), expected[5..]);
        assert!(expected.iter().zip(&expected[1..]).all(|(a, b)| a != b));
    }

    #[test]
    fn samples_are_whole_units_and_the_rest_is_padding() {
        let batch = &batches(&config(), 0..263, 0, 1)[0];
        assert_eq!((batch.channels, batch.frames), (263, 50));
        assert_eq!((batch.cond_channels, batch.cond_frames), (512, 1));
        assert_eq!(batch.cond.len(), 3 * 512);
        for sample in 0..3 {
            let mask = &batch.mask[50 * sample..][..50];
            assert!(mask[..48].iter().all(|&value| value == 1.0));
            assert_eq!(mask[48..], [0.0, 0.0]);
            for channel in 0..263 {
                let row = &batch.x_start[(sample * 263 + channel) * 50..][..50];
                assert_eq!(row[48..], [0.0, 0.0]);
            }
            let condition = &batch.cond[512 * sample..][..512];
            let square: f32 = condition.iter().map(|value| value * value).sum();
            assert!((square - 1.0).abs() < 1e-4, "{square}");
        }
    }

    #[test]
    fn crops_are_anchored_at_the_origin_and_are_those_of_their_clip() {
        for root in [Root::Absolute, Root::Relative] {
            let mut config = config();
            config.humanml3d.root = root;
            let dataset = ClipDataset::open(&config).unwrap();
            let statistics = Arc::new(dataset.statistics.clone());
            let mut starts = BTreeSet::new();
            for batch in batches(&config, 0..263, 0, 6) {
                for sample in 0..3 {
                    // A passage may be shorter than the crop.
                    let mask = &batch.mask[50 * sample..][..50];
                    let valid = mask.iter().filter(|&&value| value == 1.0).count();
                    assert!(valid >= 40 && valid % 4 == 0, "{valid}");
                    let rows = &batch.x_start[sample * 263 * 50..][..263 * 50];
                    let values = rows.chunks(50).flat_map(|row| &row[..valid]).copied();
                    let values: Vec<f32> = values.collect();
                    let found = statistics.denormalize(&values).unwrap();
                    if root == Root::Absolute {
                        let first = &found.frame(0)[..3];
                        assert!(first.iter().all(|value| value.abs() < 1e-6), "{first:?}");
                    }
                    let clip = dataset.find(&batch.ids[sample]).unwrap().unwrap();
                    let normalized = |start: usize| {
                        let part = clip.features.slice(start..start + valid);
                        statistics.normalize(&part.with_root(root)).unwrap()
                    };
                    let start = (0..=90 - valid).find(|&start| normalized(start) == values);
                    starts.insert(start.expect("a window of the clip"));
                }
            }
            assert!(starts.len() > 8, "{starts:?}");
        }
    }

    #[test]
    fn the_first_channels_alone_are_those_of_all() {
        let (all, few) = (
            batches(&config(), 0..263, 0, 2),
            batches(&config(), 0..4, 0, 2),
        );
        for (all, few) in all.iter().zip(&few) {
            assert_eq!((few.channels, few.x_start.len()), (4, 3 * 4 * 50));
            for sample in 0..3 {
                let part = &all.x_start[sample * 263 * 50..][..4 * 50];
                assert_eq!(&few.x_start[sample * 4 * 50..][..4 * 50], part);
            }
            assert_eq!((&all.cond, &all.mask), (&few.cond, &few.mask));
        }
    }

    #[test]
    fn every_caption_comes_up_with_its_own_passage() {
        let mut config = config();
        config.batch_size = 64;
        let clip = (0..40).map(|index| walk(index, 90, 3));
        let mut clip = clip.filter(|clip| clip.captions.len() == 4);
        let mut clip = clip.next().expect("a walk that turns");
        // Passages that leave one start each tell the crops of captions apart.
        for (caption, seconds) in clip.captions.iter_mut().zip([
            None,
            Some((0.0, 2.0)),
            Some((1.0, 3.0)),
            Some((2.0, 4.0)),
        ]) {
            caption.seconds = seconds;
        }
        let features: Vec<_> = [(0, 40), (20, 60), (40, 80)]
            .map(|(from, to)| clip.features.slice(from..to).to_absolute())
            .to_vec();
        let statistics = Arc::new(FeatureStatistics::compute(&features).unwrap());
        let clips = ClipSet::from(vec![Arc::new(clip.clone())]);
        let mut loader = Loader::clips(clips, statistics.clone(), 0..263, &config, 1, 0);
        let batch = loader.next().unwrap();
        let mut seen = [0; 4];
        for sample in 0..64 {
            let condition = &batch.cond[512 * sample..][..512];
            let caption = clip
                .captions
                .iter()
                .position(|caption| caption.embedding.as_deref() == Some(condition));
            let caption = caption.expect("an embedding of the clip");
            seen[caption] += 1;
            if let Some(part) = caption.checked_sub(1) {
                let expected = statistics.normalize(&features[part]).unwrap();
                let rows = &batch.x_start[sample * 263 * 50..][..263 * 50];
                let found: Vec<f32> = rows.chunks(50).flat_map(|row| row[..40].to_vec()).collect();
                assert_eq!(found, expected);
            }
        }
        assert!(seen.iter().all(|&count| count > 6), "{seen:?}");
    }

    #[test]
    fn validation_takes_the_first_caption_and_the_leading_crop() {
        let config = config();
        let dataset = ClipDataset::open(&config).unwrap();
        let statistics = Arc::new(dataset.statistics);
        let clips = dataset.train.load().unwrap();
        let batch = collate_clips(&clips, &statistics, 0..263, &config);
        assert_eq!(batch.batch_size, clips.len());
        let first = clips[1].features.slice(0..48).to_absolute();
        let rows = &batch.x_start[263 * 50..][..263 * 50];
        let found: Vec<f32> = rows.chunks(50).flat_map(|row| row[..48].to_vec()).collect();
        assert_eq!(found, statistics.normalize(&first).unwrap());
        let embedding = clips[1].captions[0].embedding.as_deref();
        assert_eq!(Some(&batch.cond[512..1024]), embedding);

        let mut bare = (*clips[0]).clone();
        bare.captions.clear();
        let batch = collate_clips(&[Arc::new(bare)], &statistics, 0..4, &config);
        assert_eq!(batch.cond, [0.0; 512]);
    }
}
