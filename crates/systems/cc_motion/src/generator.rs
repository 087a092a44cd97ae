//! A trained model of phrases.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::{ChannelEncoding, Phrase, Phrases, Statistics, process_around};
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::Config;
use kinegrad_train::sampling::Style;
use kinegrad_train::{Error, TrainedModel};

use super::load::targets;
use super::{CcMotionConfig, Trained, style};
use crate::network::{AudioCondition, MotionDecoder, StyleCondition, UNet1d};

/// One sample, in physical units.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The raw model output, decoded or denormalized.
    pub raw: Phrase,
    /// Post-processed.
    pub motion: Phrase,
}

/// A trained model, ready to generate samples.
pub struct Generator {
    pub(super) unet: UNet1d,
    pub(super) decoder: Option<MotionDecoder>,
    pub(super) diffusion: GaussianDiffusion,
    pub(super) targets: ChannelEncoding,
    pub(super) post_processing: PostProcessConfig,
    /// Style of one sample; `None` is the null style.
    pub(super) style: Option<StyleCondition>,
    pub(super) device: Device,
    pub(super) state: State,
}

impl Generator {
    /// Loads the networks of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not match its config.
    pub fn load(trained: &TrainedModel) -> Result<Self, Error> {
        let Trained {
            unet,
            decoder,
            state,
        } = Trained::load(&trained.saved, trained.weights, &trained.device)?;
        state.statistics_of(&Phrases)?;
        let diffusion = GaussianDiffusion::new(&state.config.own::<CcMotionConfig>().diffusion)?;
        let decoder = decoder.map(|decoder| decoder.valid());
        let device = &trained.device;
        Ok(Self::of(unet.valid(), decoder, diffusion, state, device))
    }

    /// Networks without gradients on `device`, with the training settings of `state`.
    pub(super) fn of(
        unet: UNet1d,
        decoder: Option<MotionDecoder>,
        diffusion: GaussianDiffusion,
        state: State,
        device: &Device,
    ) -> Self {
        let evaluation = &state.config.own::<CcMotionConfig>().evaluation;
        Self {
            unet,
            decoder,
            diffusion,
            targets: targets(&state.config),
            post_processing: evaluation.postprocess.clone(),
            style: None,
            state,
            device: device.clone(),
        }
    }

    /// The same generator with a post-processing and a style.
    ///
    /// # Errors
    /// If the model does not support the style condition, or does not know the label.
    pub(super) fn with(
        self,
        post_processing: PostProcessConfig,
        style: Option<&Style>,
    ) -> Result<Self, Error> {
        let encoded =
            |style| style::of_sample(style, self.config(), self.statistics(), &self.device);
        let style = style.map(encoded).transpose()?;
        Ok(Self {
            post_processing,
            style,
            ..self
        })
    }

    /// `values` on the device of the networks.
    pub(super) fn on_device(&self, values: Vec<f32>, shape: [usize; 3]) -> Tensor<3> {
        Tensor::from_data(TensorData::new(values, shape), &self.device)
    }

    /// The condition of samples for `features`, `[batch, channels, time]`.
    pub(super) fn condition(&self, features: Tensor<3>) -> AudioCondition {
        let batch = features.dims()[0];
        AudioCondition {
            style: self.style.as_ref().map(|style| style.repeated(batch)),
            ..features.into()
        }
    }

    /// The config the model was trained with.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    /// The statistics of the model's training phrases, for the 25 channels.
    pub fn statistics(&self) -> &Statistics {
        &self.state.statistics
    }

    /// The motion of a normalized output `[channels, frames]`, and each heading's confidence, 0 to
    /// 1.
    pub(super) fn predicted(&self, values: &[f32]) -> Result<(Phrase, Vec<f64>), Error> {
        let rows = self.state.normalization().denormalize(values);
        let confidence = self.targets.confidence(&rows);
        Ok((Phrase::new(self.targets.decode(rows))?, confidence))
    }

    /// The post-processed sample of a raw motion with some known frames.
    pub(super) fn finished(&self, raw: Phrase, confidence: &[f64], is_known: &[bool]) -> Sample {
        let (steps, statistics) = (&self.post_processing, Some(self.statistics()));
        let motion = process_around(&raw, steps, statistics, is_known, confidence);
        Sample { raw, motion }
    }
}
