//! Autoregressive motion from a checkpoint.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Error as Diffusion, SamplerConfig};
use kinegrad_motion::humanml::{Extraction, FeatureError, Joints, TEXT_CHANNELS};
use kinegrad_random::Key;
use kinegrad_train::checkpoint::State;
use kinegrad_train::clips::captions::{ClipText, TextInput};
use kinegrad_train::config::Config;
use kinegrad_train::{Error, TrainedModel};

use super::load::{model, text_input};
use super::{FlowTables, RolloutEvaluationConfig, statistics_in};
use crate::network::{FlowModel, FlowRollout, FlowSpace, RolloutSettings};

/// A trained pair of networks that continues a history.
pub struct FlowGenerator {
    model: FlowModel,
    space: FlowSpace,
    text: TextInput,
    state: State,
    device: Device,
}

impl FlowGenerator {
    /// Loads the networks of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn load(trained: &TrainedModel) -> Result<Self, Error> {
        let (device, state) = (&trained.device, trained.saved.state.clone());
        let own: &FlowTables = state.config.own();
        let [features, target] = statistics_in(&state)?;
        let network = model(&state.config, &device.clone().autodiff())?;
        Ok(Self {
            model: trained.load(network)?.valid(),
            space: FlowSpace {
                skeleton: state.config.data.humanml3d.skeleton(),
                features,
                target,
                next: own.pose.target,
                prediction: own.pose.prediction_type,
                history: own.pose.history_frames,
                longest: state.config.data.target_frames,
            },
            text: text_input(&state.config),
            state,
            device: device.clone(),
        })
    }

    /// The run's config.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    /// The 512 numbers of a text, for [`FlowRollout::push_text`]; zeros without a text.
    ///
    /// # Errors
    /// [`Error::Usage`] for a text that the model does not know.
    pub fn text(&self, text: Option<&ClipText>) -> Result<Vec<f32>, Error> {
        // A prompt may be empty.
        let text = text.filter(|text| **text != ClipText::default());
        let values = text.map(|text| self.text.values(text)).transpose()?;
        let Some(values) = values.flatten() else {
            return Ok(vec![0.0; TEXT_CHANNELS]);
        };
        let shape = [1, values.len()];
        let values = Tensor::from_data(TensorData::new(values, shape), &self.device);
        let numbers = self.model.text(values).try_into_vec_as::<f32>();
        Ok(numbers.expect("weights are float32"))
    }

    /// The next frame of the motion with name `sample`; `None` after the last frame.
    pub(super) fn next_frame(
        rollout: &mut FlowRollout,
        sample: &dyn Fn() -> String,
    ) -> Result<Option<Vec<[f64; 3]>>, Error> {
        rollout.next_frame().map_err(|error| match error {
            Error::Features(FeatureError::NonFinite { .. })
            | Error::Diffusion(Diffusion::NotFinite) => Error::SampleNotFinite {
                sample: format!("{}, frame {}", sample(), rollout.generated()),
            },
            other => other,
        })
    }

    /// A rollout before its first frame, without a text. Sampled according to `how`, `frames`
    /// frames will follow the `history` (joints in meters above the floor, at the skeleton's frame
    /// rate).
    ///
    /// # Errors
    /// If the history is too short or has another skeleton, or a setting is invalid.
    pub fn rollout(
        &self,
        history: &Joints,
        frames: usize,
        sampler: &SamplerConfig,
        how: &RolloutEvaluationConfig,
        key: Key,
    ) -> Result<FlowRollout, Error> {
        let settings = RolloutSettings {
            sampler: sampler.clone(),
            frames,
            constant_bones: how.constant_bones,
            same_noise: how.same_noise,
            contact_threshold: Extraction::default().contact_threshold,
        };
        let (model, space) = (self.model.clone(), self.space.clone());
        FlowRollout::new(model, space, settings, history, key, &self.device)
    }
}
