//! Frame after frame, each the history of the next.

use std::collections::VecDeque;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{FlowPrediction, SamplerConfig, must_suit_flow};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::stream::with_bones;
use kinegrad_motion::humanml::{
    FeatureError, FeatureStream, Joints, NextPose, Skeleton, TEXT_CHANNELS,
};
use kinegrad_random::Key;
use kinegrad_settings::{InvalidSetting, Refused, in_range};
use miette::Diagnostic;
use thiserror::Error;

use super::{FlowCondition, FlowModel, History, previous_state};

/// The features and statistics that a model was trained with.
#[derive(Clone, Debug)]
pub struct FlowSpace {
    /// The skeleton whose joints it has.
    pub skeleton: Skeleton,
    /// Of the features of a frame, with the heading of each frame by itself: `12 J - 1` channels.
    pub features: Statistics,
    /// Of the target, joint by joint: `3 J` channels.
    pub target: Statistics,
    /// The target of training.
    pub next: NextPose,
    /// The quantity that the predictor predicts.
    pub prediction: FlowPrediction,
    /// Rows of features in a history.
    pub history: usize,
    /// Frames that a duration of 1 stands for.
    pub longest: usize,
}

/// The settings of a rollout.
#[derive(Clone, Debug)]
pub struct RolloutSettings {
    /// The solver of each pose.
    pub sampler: SamplerConfig,
    /// Frames to sample; progress counts down from 1 at the first to 0 at the last.
    pub frames: usize,
    /// Gives every frame the bones of the history's last ([`with_bones`]).
    pub constant_bones: bool,
    /// Samples every pose from the same noise, so that consecutive poses differ by their conditions
    /// alone.
    pub same_noise: bool,
    /// Of the contact flags, square metres
    /// ([`Extraction::contact_threshold`](kinegrad_motion::humanml::Extraction::contact_threshold)).
    pub contact_threshold: f64,
}

/// Errors of a rollout.
#[derive(Debug, Diagnostic, Error)]
pub enum RolloutError {
    /// The history has too few frames.
    #[error("the history has {found} frames where at least {needed} are needed")]
    #[diagnostic(help(
        "every row of features is taken from a frame and the next, and the last frame is the one \
         that the motion continues from"
    ))]
    HistoryTooShort {
        /// Frames found.
        found: usize,
        /// Frames needed.
        needed: usize,
    },
    /// A text's feature of another size, or with a value that is not finite.
    #[error("a text of {found} numbers, of which {bad} are not finite")]
    #[diagnostic(help("a text is {TEXT_CHANNELS} finite numbers, zeros for no text"))]
    Text {
        /// Numbers found.
        found: usize,
        /// Those that are not finite.
        bad: usize,
    },
    /// A setting that does not work.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),
    /// Statistics of another skeleton, or a frame that is not finite.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Feature(#[from] FeatureError),
    /// A pose could not be sampled.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Sampler(#[from] kinegrad_diffusion::Error),
}

/// A motion that continues a history: the text is pushed, frames are pulled. Memory does not grow
/// with the frames. Every frame is a function of the history, the texts so far and
/// the key.
///
/// Make it with a model of plain weights on a plain device (Burn: `Module::valid`).
#[derive(Debug)]
pub struct FlowRollout {
    model: FlowModel,
    space: FlowSpace,
    settings: RolloutSettings,
    device: Device,
    key: Key,
    stream: FeatureStream,
    /// The last rows, normalised, the oldest first.
    rows: VecDeque<Vec<f32>>,
    bones: Option<Vec<[f64; 3]>>,
    text: Vec<f32>,
    generated: usize,
    evaluations: usize,
}

impl FlowRollout {
    /// Before its first frame, without a text. The history is joints in metres above the floor y =
    /// 0, at the skeleton's rate: the motion continues from its last frame, and
    /// the encoder reads as many frames before it as a history has rows.
    ///
    /// # Errors
    /// [`RolloutError::HistoryTooShort`]; [`RolloutError::Setting`] for a setting out of range;
    /// [`RolloutError::Feature`] if history or statistics are of another skeleton.
    pub fn new(
        model: FlowModel,
        space: FlowSpace,
        settings: RolloutSettings,
        history: &Joints,
        key: Key,
        device: &Device,
    ) -> Result<Self, RolloutError> {
        must_suit_flow(&settings.sampler)?;
        in_range("frames", settings.frames, 1..).hint("20 frames are a second of HumanML3D")?;
        in_range("history", space.history, 1..).hint("the source has 15")?;
        in_range("longest", space.longest, 1..).hint("196 in HumanML3D")?;
        let skeleton = &space.skeleton;
        history.must_be_of(skeleton)?;
        let channels = skeleton.layout().channels();
        let found = space.features.channels();
        FeatureError::unless_equal("statistics of the features", channels, found)?;
        let found = space.target.channels();
        FeatureError::unless_equal("statistics of the target", 3 * skeleton.joints(), found)?;
        let (found, needed) = (history.frames(), space.history + 1);
        if found < needed {
            return Err(RolloutError::HistoryTooShort { found, needed });
        }
        let stream = FeatureStream::new(skeleton.clone(), settings.contact_threshold)?;
        let last = history.frame(found - 1);
        let mut rollout = Self {
            bones: settings
                .constant_bones
                .then(|| skeleton.offsets_of_frame(last)),
            stream: stream.with_own_heading(),
            rows: VecDeque::with_capacity(space.history + 1),
            text: vec![0.0; TEXT_CHANNELS],
            device: device.clone(),
            generated: 0,
            evaluations: 0,
            model,
            space,
            settings,
            key,
        };
        for t in found - needed..found {
            rollout.take(history.frame(t))?;
        }
        Ok(rollout)
    }

    /// Continues with another text, 512 numbers; zeros for no text.
    ///
    /// # Errors
    /// [`RolloutError::Text`]; the text before then stays.
    pub fn push_text(&mut self, text: &[f32]) -> Result<(), RolloutError> {
        let bad = text.iter().filter(|value| !value.is_finite()).count();
        if text.len() != TEXT_CHANNELS || bad > 0 {
            let found = text.len();
            return Err(RolloutError::Text { found, bad });
        }
        self.text = text.to_vec();
        Ok(())
    }

    /// The next frame, `[J, 3]` in metres, where the history is; none after the last.
    ///
    /// # Errors
    /// [`RolloutError::Sampler`] and [`RolloutError::Feature`], of a network that answers numbers
    /// that are not finite. The frame is then not generated.
    pub fn next_frame(&mut self) -> Result<Option<Vec<[f64; 3]>>, RolloutError> {
        if self.generated == self.settings.frames {
            return Ok(None);
        }
        let target = self.sample()?;
        let Some((last, facing)) = self.stream.last() else {
            unreachable!("a rollout begins with a history");
        };
        let mut frame = self.space.next.apply(&target, last, facing)?;
        if let Some(bones) = &self.bones {
            frame = with_bones(&self.space.skeleton, &frame, bones)?;
        }
        self.take(&frame)?;
        self.generated += 1;
        Ok(Some(frame))
    }

    /// Number of frames that remain.
    pub fn remaining(&self) -> usize {
        self.settings.frames - self.generated
    }

    /// Number of frames generated so far.
    pub fn generated(&self) -> usize {
        self.generated
    }

    /// Velocities that the solver has taken, over all frames.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Makes a frame part of the history.
    fn take(&mut self, frame: &[[f64; 3]]) -> Result<(), RolloutError> {
        if let Some(row) = self.stream.push(frame)? {
            self.rows.push_back(self.space.features.normalize(&row));
            if self.rows.len() > self.space.history {
                self.rows.pop_front();
            }
        }
        Ok(())
    }

    /// The next target, `[J, 3]` in metres.
    fn sample(&mut self) -> Result<Vec<f32>, RolloutError> {
        let joints = self.space.skeleton.joints();
        let number = match self.settings.same_noise {
            true => 0,
            false => self.generated as u64,
        };
        let noise = self.key.at(number).normals(3 * joints);
        let noise = Tensor::from_data(TensorData::new(noise, [1, 3, joints]), &self.device);
        let flowed = self.model.predictor.sample(
            noise,
            &self.condition(),
            self.space.prediction,
            &self.settings.sampler,
        )?;
        self.evaluations += flowed.evaluations;
        let of_joints = flowed.x.swap_dims(1, 2).into_data();
        let of_joints = of_joints.try_to_vec::<f32>().expect("float32");
        Ok(self.space.target.denormalize(&of_joints))
    }

    /// The condition of the next pose.
    fn condition(&self) -> FlowCondition {
        let rows = self.rows.len();
        let channels = self.space.features.channels();
        let values: Vec<f32> = self.rows.iter().flatten().copied().collect();
        let frames: Tensor<3> =
            Tensor::from_data(TensorData::new(values, [1, rows, channels]), &self.device);
        let last = frames.clone().narrow(1, rows - 1, 1);
        let text = TensorData::new(self.text.clone(), [1, TEXT_CHANNELS]);
        let text = Tensor::<2>::from_data(text, &self.device);
        // Training has no larger durations.
        let poses = self.settings.frames.min(self.space.longest);
        let duration = poses as f32 / self.space.longest as f32;
        let history = History {
            frames: frames.swap_dims(1, 2),
            lengths: vec![rows],
            text: text.clone(),
            duration: Some(Tensor::full([1, 1], duration, &self.device)),
        };
        let guides = self.settings.sampler.guidance_scale != 1.0;
        let null_context = guides.then(|| {
            self.model.encoder.forward(History {
                text: text.zeros_like(),
                ..history.clone()
            })
        });
        let behind = self.generated as f32 / (self.settings.frames - 1).max(1) as f32;
        FlowCondition {
            context: self.model.encoder.forward(history),
            null_context,
            previous: previous_state(last.reshape([1, channels])),
            progress: Tensor::full([1], 1.0 - behind, &self.device),
        }
    }
}

#[cfg(test)]
mod tests;
