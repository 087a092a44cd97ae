//! A trained model of phrases.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::{ChannelEncoding, Phrase, Phrases, Statistics, process_around};
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::Config;
use kinegrad_train::sampling::Style;
use kinegrad_train::{Error, TrainedModel};

use super::load::targets;
use super::style::EncodedStyle;
use super::{CcMotionConfig, Trained};
use crate::network::{AudioCondition, MotionDecoder, UNet1d};

/// One sample, in physical units.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The raw model output, decoded or de-normalised.
    pub raw: Phrase,
    /// Post-processed.
    pub motion: Phrase,
}

/// A motion as a network predicts it.
pub(super) struct Raw {
    motion: Phrase,
    /// Confidence of each frame's heading, 0 to 1.
    confidence: Vec<f64>,
}

/// For a decoder, which has no confidence.
impl From<Phrase> for Raw {
    fn from(motion: Phrase) -> Self {
        let confidence = vec![1.0; motion.frames()];
        Self { motion, confidence }
    }
}

/// A trained model, ready to generate samples.
pub struct Generator {
    pub(super) unet: UNet1d,
    pub(super) decoder: Option<MotionDecoder>,
    pub(super) diffusion: GaussianDiffusion,
    pub(super) targets: ChannelEncoding,
    pub(super) post_processing: PostProcessConfig,
    pub(super) style: Option<EncodedStyle>,
    pub(super) device: Device,
    pub(super) state: State,
}

impl Generator {
    /// Loads the networks of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not fit its own config.
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
        Self {
            unet,
            decoder,
            diffusion,
            targets: targets(&state.config),
            post_processing: PostProcessConfig::default(),
            style: None,
            state,
            device: device.clone(),
        }
    }

    /// The same with another post-processing than the default.
    #[must_use]
    pub fn with_post_processing(self, post_processing: PostProcessConfig) -> Self {
        Self {
            post_processing,
            ..self
        }
    }

    /// The same with a style; without one the null style is used.
    ///
    /// # Errors
    /// If the model is not conditioned on such a style, or does not know the label.
    pub fn with_style(self, style: Option<&Style>) -> Result<Self, Error> {
        let style = style
            .map(|style| EncodedStyle::new(style, self.config(), self.statistics()))
            .transpose()?;
        Ok(Self { style, ..self })
    }

    /// The condition of samples for `features`, `[batch, channels, time]`.
    pub(super) fn condition(&self, features: Tensor<3>) -> AudioCondition {
        let (batch, device) = (features.dims()[0], features.device());
        AudioCondition {
            style: self
                .style
                .as_ref()
                .map(|style| style.repeated(batch, &device)),
            ..features.into()
        }
    }

    /// The config the model was trained with.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    /// The statistics of its training phrases, of the 25 channels.
    pub fn statistics(&self) -> &Statistics {
        &self.state.statistics
    }

    /// The motion of the network's normalised output, `[channels, frames]`.
    ///
    /// # Errors
    /// If they are not whole frames.
    pub(super) fn predicted(&self, values: &[f32]) -> Result<Raw, Error> {
        let rows = self.state.normalization().denormalize(values);
        let confidence = self.targets.confidence(&rows);
        let motion = Phrase::new(self.targets.decode(rows))?;
        Ok(Raw { motion, confidence })
    }

    /// The post-processed sample of a raw motion of which some frames are known.
    pub(super) fn finished(&self, raw: Raw, is_known: &[bool]) -> Sample {
        let Raw { motion, confidence } = raw;
        let (steps, statistics) = (&self.post_processing, Some(self.statistics()));
        let processed = process_around(&motion, steps, statistics, is_known, &confidence);
        Sample {
            raw: motion,
            motion: processed,
        }
    }
}
