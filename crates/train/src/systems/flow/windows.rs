//! From clips to samples: a history, the next pose, and what is known beside them.

use std::f64::consts::TAU;
use std::sync::Arc;

use kinegrad_data::humanml::{Caption, CaptionLabels, Clip, ClipSet};
use kinegrad_data::{Batch, ConditionRows, Error, SampleShape, Samples, TEXT};
use kinegrad_motion::humanml::{
    Extraction, FeatureError, FeatureStream, Joints, NextPose, Skeleton, TEXT_CHANNELS,
};
use kinegrad_motion::{ChannelMoments, Quaternion, Statistics};
use kinegrad_random::{Key, Purpose};

use super::PoseConfig;

/// Name of the condition on past frames, `[12 J - 1, history]`, normalised.
pub(super) const HISTORY: &str = "history";

/// Name of the condition on where in the motion the next pose is, `[2, 1]`: progress, 1 at the first
/// pose after the first history and 0 at the last, and the number of poses over those of the longest
/// motion.
pub(super) const PLACE: &str = "place";

/// What the numbers of a sample mean.
#[derive(Clone, Debug)]
pub struct PoseSpace {
    /// The skeleton.
    pub skeleton: Skeleton,
    /// Rows in a history.
    pub history: usize,
    /// What is predicted.
    pub target: NextPose,
    /// Poses that a duration of 1 stands for.
    pub longest: usize,
}

impl PoseSpace {
    /// That of a config's table `pose`.
    pub fn new(skeleton: Skeleton, pose: &PoseConfig, longest: usize) -> Self {
        Self {
            skeleton,
            history: pose.history_frames,
            target: pose.target,
            longest,
        }
    }

    /// Frames of which the last is a pose to predict and the others make its history.
    pub fn window(&self) -> usize {
        self.history + 2
    }

    /// The rows of features of `frames`, one less than those, each with its own heading and wherever
    /// the first one faces.
    ///
    /// # Errors
    /// For joints of another skeleton, and such as are not finite.
    pub fn rows(&self, frames: &Joints) -> Result<Vec<Vec<f32>>, FeatureError> {
        let threshold = Extraction::default().contact_threshold;
        let stream = FeatureStream::new(self.skeleton.clone(), threshold)?;
        let mut stream = stream.facing_anywhere();
        let mut rows = Vec::with_capacity(frames.frames());
        for t in 0..frames.frames() {
            rows.extend(stream.push(frames.frame(t))?);
        }
        Ok(rows)
    }

    /// Moments of the features and of the target of a clip.
    ///
    /// # Panics
    /// Panics for a clip of another skeleton.
    pub fn moments(&self, clip: &Clip) -> [ChannelMoments; 2] {
        let rows = self.rows(&clip.features.joints());
        let rows = rows.expect("the reader takes clips of this skeleton alone");
        let targets: Vec<f32> = rows.iter().flat_map(|row| self.target_of(row)).collect();
        let (channels, joints) = (self.skeleton.layout().channels(), self.skeleton.joints());
        [
            ChannelMoments::measure(channels, [&rows.concat()[..]]),
            ChannelMoments::measure(3 * joints, [&targets[..]]),
        ]
    }

    fn target_of(&self, row: &[f32]) -> Vec<f32> {
        let target = self.target.of_row(row);
        target.expect("rows of this skeleton")
    }
}

/// Windows of clips: in every sample one, drawn anew in each epoch and turned by any angle, for the
/// rotations of features depend on where a body faces and a motion that goes on may face anywhere.
#[derive(Clone, Debug)]
pub struct PoseWindows {
    clips: ClipSet,
    space: PoseSpace,
    features: Arc<Statistics>,
    target: Arc<Statistics>,
    labels: Option<CaptionLabels>,
    seed: u64,
}

impl PoseWindows {
    /// Windows of `clips`, histories normalised by `features` and poses by `target`.
    pub fn new(
        clips: ClipSet,
        space: PoseSpace,
        features: Arc<Statistics>,
        target: Arc<Statistics>,
        labels: Option<CaptionLabels>,
        seed: u64,
    ) -> Self {
        Self {
            clips,
            space,
            features,
            target,
            labels,
            seed,
        }
    }

    fn text_channels(&self) -> usize {
        let labels = self.labels.as_ref();
        labels.map_or(TEXT_CHANNELS, |labels| labels.captions().len())
    }

    fn text_of(&self, caption: Option<&Caption>) -> Vec<f32> {
        let none = || vec![0.0; TEXT_CHANNELS];
        match &self.labels {
            Some(labels) => labels.values(caption.and_then(|caption| labels.row(&caption.text))),
            None => caption
                .and_then(|caption| caption.embedding.as_deref())
                .map_or_else(none, <[f32]>::to_vec),
        }
    }
}

impl Samples for PoseWindows {
    type Item = Clip;
    type Read = Arc<Clip>;

    fn items(&self) -> &ClipSet {
        &self.clips
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: self.target.channels(),
            frames: 1,
            conditions: vec![
                (HISTORY, self.features.channels(), self.space.history),
                (PLACE, 2, 1),
                (TEXT, self.text_channels(), 1),
            ],
        }
    }

    fn read(&self, position: usize) -> Result<Arc<Clip>, Error> {
        self.clips.get(position)
    }

    /// Validation takes the first caption, and a window that follows from the clip's id.
    fn push(&self, batch: &mut Batch, clip: &Arc<Clip>, number: Option<u64>) {
        let key = |purpose| match number {
            Some(number) => Key::new(self.seed, purpose).at(number),
            None => Key::new(0, purpose).named(&clip.id),
        };
        let below = |bound, purpose| key(purpose).integers(1, bound)[0];
        let caption = match (clip.captions.len(), number) {
            (0, _) => None,
            (_, None) => clip.captions.first(),
            (count, Some(_)) => Some(&clip.captions[below(count, Purpose::Caption)]),
        };
        let all = clip.features.frames();
        let passage = caption.map_or(0..all, |caption| {
            caption.frames(all, self.space.skeleton.description().fps)
        });
        let passage = match passage.len() < self.space.window() {
            true => 0..all,
            false => passage,
        };
        let poses = passage.len() + 1 - self.space.window();
        let pose = below(poses, Purpose::Crop);
        let first = passage.start + pose;
        let joints = clip.features.joints();
        let angle = number.map_or(0.0, |_| TAU * key(Purpose::Augment).uniform());
        let window = turned(&joints, first..first + self.space.window(), angle);
        let rows = self.space.rows(&window);
        let mut rows = rows.expect("the reader takes clips of this skeleton alone");
        let last = rows.pop().expect("a window has a next pose");
        let (history, channels) = (rows.len(), self.features.channels());
        let rows: Vec<f32> = rows
            .iter()
            .flat_map(|row| self.features.normalize(row))
            .collect();
        let by_channel = (0..channels).flat_map(|c| rows.iter().skip(c).step_by(channels));
        let by_channel: Vec<f32> = by_channel.copied().collect();
        let place = place(pose, poses, self.space.longest);
        let text = self.text_of(caption);
        fn whole(values: &[f32], frames: usize) -> ConditionRows<'_> {
            ConditionRows {
                values,
                frames,
                range: 0..frames,
            }
        }
        batch.push(
            &clip.id,
            &self.space.target_of(&last),
            &self.target,
            &[
                whole(&by_channel, history),
                whole(&place, 1),
                whole(&text, 1),
            ],
        );
    }
}

/// Progress and duration of pose number `pose` of so many.
pub(super) fn place(pose: usize, poses: usize, longest: usize) -> [f32; 2] {
    let behind = pose as f32 / (poses - 1).max(1) as f32;
    [1.0 - behind, poses as f32 / longest as f32]
}

/// Some frames, turned about the vertical axis by an angle in radians.
fn turned(joints: &Joints, frames: std::ops::Range<usize>, angle: f64) -> Joints {
    let turn = Quaternion::from_yaw(angle);
    let places = frames.flat_map(|t| joints.frame(t).iter().map(|&place| turn.rotate(place)));
    Joints::new(places.collect(), joints.joints()).expect("whole frames")
}
