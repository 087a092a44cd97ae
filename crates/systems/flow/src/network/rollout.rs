//! Autoregressive sampling, frame by frame.

use std::collections::VecDeque;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{FlowPrediction, SamplerConfig, must_suit_flow};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::stream::with_bones;
use kinegrad_motion::humanml::{
    FeatureError, FeatureStream, Joints, NextPose, Skeleton, TEXT_CHANNELS,
};
use kinegrad_random::Key;
use kinegrad_settings::{Refused, counted, in_range};
use kinegrad_train::Error;

use super::{FlowCondition, FlowModel, History, previous_state};

/// The features and statistics of a model's training.
#[derive(Clone, Debug)]
pub struct FlowSpace {
    /// The skeleton.
    pub skeleton: Skeleton,
    /// Statistics of features with the heading of each frame, `12 J - 1` channels.
    pub features: Statistics,
    /// Statistics of the target, joint by joint: `3 J` channels.
    pub target: Statistics,
    /// The target.
    pub next: NextPose,
    /// The prediction type.
    pub prediction: FlowPrediction,
    /// Rows of features in a history.
    pub history: usize,
    /// Number of frames for a duration of 1.
    pub longest: usize,
}

/// The settings of a rollout.
#[derive(Clone, Debug)]
pub struct RolloutSettings {
    /// The solver of each pose.
    pub sampler: SamplerConfig,
    /// Frames to sample; progress decreases from 1 at the first frame to 0 at the last frame.
    pub frames: usize,
    /// Gives every frame the bone lengths of the history's last frame ([`with_bones`]).
    pub constant_bones: bool,
    /// Samples all poses from the same noise, so that consecutive poses differ only by their
    /// conditions.
    pub same_noise: bool,
    /// [`Extraction::contact_threshold`](kinegrad_motion::humanml::Extraction::contact_threshold).
    pub contact_threshold: f64,
}

/// A motion that continues a history: the caller pushes texts and pulls frames. Memory does not
/// grow with the number of frames. Each frame is a function of the history, the texts so far and
/// the key.
///
/// The model must be without gradients (Burn: `Module::valid`).
#[derive(Debug)]
pub struct FlowRollout {
    model: FlowModel,
    space: FlowSpace,
    settings: RolloutSettings,
    device: Device,
    key: Key,
    stream: FeatureStream,
    /// The last rows, normalized, oldest first.
    rows: VecDeque<Vec<f32>>,
    bones: Option<Vec<[f64; 3]>>,
    text: Vec<f32>,
    generated: usize,
    evaluations: usize,
}

impl FlowRollout {
    /// A rollout before its first frame, without a text. The motion continues from the last frame
    /// of the history: joints in meters above the floor y = 0, at the skeleton's frame rate.
    ///
    /// # Errors
    /// If the history is too short or has another skeleton, or a setting is out of range.
    pub fn new(
        model: FlowModel,
        space: FlowSpace,
        settings: RolloutSettings,
        history: &Joints,
        key: Key,
        device: &Device,
    ) -> Result<Self, Error> {
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
            let hint = "every row of features is taken from a frame and the next, and the last frame \
                        is the one that the motion continues from";
            let message = format!(
                "the history has {} where at least {needed} are needed",
                counted(found, "frame")
            );
            return Err(Error::usage(message, hint));
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

    /// Continues with another text, 512 numbers; zeros mean no text.
    ///
    /// # Errors
    /// If `text` is invalid; the previous text then remains.
    pub fn push_text(&mut self, text: &[f32]) -> Result<(), Error> {
        let bad = text.iter().filter(|value| !value.is_finite()).count();
        if text.len() != TEXT_CHANNELS || bad > 0 {
            let found = text.len();
            let message = format!("a text of {found} numbers, of which {bad} are not finite");
            let hint = format!("a text is {TEXT_CHANNELS} finite numbers, zeros for no text");
            return Err(Error::usage(message, hint));
        }
        self.text = text.to_vec();
        Ok(())
    }

    /// The next frame, `[J, 3]` in meters; `None` after the last frame.
    ///
    /// # Errors
    /// If an output of the network is not finite. The call then generates no frame.
    pub fn next_frame(&mut self) -> Result<Option<Vec<[f64; 3]>>, Error> {
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

    /// Remaining frames.
    pub fn remaining(&self) -> usize {
        self.settings.frames - self.generated
    }

    /// Frames generated so far.
    pub fn generated(&self) -> usize {
        self.generated
    }

    /// Velocity evaluations of the solver, over all frames.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    fn take(&mut self, frame: &[[f64; 3]]) -> Result<(), Error> {
        if let Some(row) = self.stream.push(frame)? {
            self.rows.push_back(self.space.features.normalize(&row));
            if self.rows.len() > self.space.history {
                self.rows.pop_front();
            }
        }
        Ok(())
    }

    /// The next target, `[J, 3]` in meters.
    fn sample(&mut self) -> Result<Vec<f32>, Error> {
        let joints = self.space.skeleton.joints();
        let number = match self.settings.same_noise {
            true => 0,
            false => self.generated as u64,
        };
        let noise = self.key.at(number).normals(3 * joints);
        let noise = Tensor::from_data(TensorData::new(noise, [1, 3, joints]), &self.device);
        let (prediction, sampler) = (self.space.prediction, &self.settings.sampler);
        let predictor = &self.model.predictor;
        let flowed = predictor.sample(noise, &self.condition(), prediction, sampler)?;
        self.evaluations += flowed.evaluations;
        let of_joints = flowed.x.swap_dims(1, 2).into_data();
        let of_joints = of_joints.try_to_vec::<f32>().expect("float32");
        Ok(self.space.target.denormalize(&of_joints))
    }

    fn condition(&self) -> FlowCondition {
        let rows = self.rows.len();
        let channels = self.space.features.channels();
        let values: Vec<f32> = self.rows.iter().flatten().copied().collect();
        let values = TensorData::new(values, [1, rows, channels]);
        let frames = Tensor::<3>::from_data(values, &self.device);
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
        let without_text = || History {
            text: text.zeros_like(),
            ..history.clone()
        };
        let null_context = guides.then(|| self.model.encoder.forward(without_text()));
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
