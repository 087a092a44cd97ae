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
        let passage = if passage.is_empty() { 0..frames } else { passage };
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
            values.map(move |value| ((value - mean) / std) as f32).collect::<Vec<_>>()
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
