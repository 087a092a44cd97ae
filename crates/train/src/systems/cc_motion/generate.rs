//! Generating phrases from a checkpoint.

use std::ops::ControlFlow;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::AudioFeatures;
use kinegrad_diffusion::{GaussianDiffusion, NoiseKeys, sample};
use kinegrad_kernels::batch_invariant;
use kinegrad_models::{AudioCondition, MotionDecoder, UNet1d};
use kinegrad_motion::phrase::CHANNELS;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::{ChannelEncoding, Phrase, Phrases, Statistics, process_around};
use kinegrad_random::{Key, Purpose};

use super::lengths::windows;
use super::networks::{footprint, targets};
use super::style::Asked;
use super::whole::{WINDOWS_IN_FLIGHT, Whole};
use super::{CcMotionConfig, Trained};
use crate::TrainedModel;
use crate::checkpoint::State;
use crate::config::{Config, SamplingConfig};
use crate::error::Error;
use crate::memory;
use crate::sampling::{Needs, Style};

/// Maximum batch size.
const BATCH: usize = 32;

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
    /// How sure it is of the heading of each frame, 0 to 1.
    confidence: Vec<f64>,
}

/// Of a decoder, which does not say how sure it is.
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
    pub(super) style: Option<Asked>,
    pub(super) device: Device,
    pub(super) state: State,
}

/// The memory of a batch of `count` samples of `frames` frames.
///
/// # Errors
/// If a network cannot be built.
pub(super) fn needs(
    trained: &TrainedModel,
    count: usize,
    frames: usize,
    hint: &'static str,
) -> Result<Needs, Error> {
    let (batch, frames) = match windows(trained.config(), frames) {
        Some(windows) => (windows.len().min(WINDOWS_IN_FLIGHT), windows.length()),
        None => (count.min(BATCH), frames),
    };
    let networks = footprint(trained.config(), frames)?;
    Ok(Needs {
        work: format!("sampling {batch} phrases of {frames} frames"),
        bytes: networks.of_sampling(batch, false, trained.on_host),
        hint,
    })
}

/// Rejects `count` samples of `frames` frames by each of `processes` if a batch of them takes more
/// memory than is free.
///
/// # Errors
/// [`Error::Usage`] with both figures.
pub(super) fn must_fit(
    trained: &TrainedModel,
    count: usize,
    frames: usize,
    processes: usize,
    hint: &'static str,
) -> Result<(), Error> {
    let needs = needs(trained, count, frames, hint)?;
    let bytes = needs.bytes.saturating_mul(processes as u64);
    memory::must_fit(&needs.work, bytes, hint)
}

/// Keys of the noise of the first `count` samples of one condition.
pub fn keys(seed: u64, count: usize) -> impl ExactSizeIterator<Item = Key> {
    let key = Key::new(seed, Purpose::Sampling);
    (0..count).map(move |number| key.at(number as u64))
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

    /// Networks without gradients on `device`, and what `state` says of their training.
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

    /// The same for samples of a style; without one they are of the null style.
    ///
    /// # Errors
    /// If the model is not conditioned on such a style, or does not know the label.
    pub fn with_style(self, style: Option<&Style>) -> Result<Self, Error> {
        let style = style
            .map(|style| Asked::new(style, self.config(), self.statistics()))
            .transpose()?;
        Ok(Self { style, ..self })
    }

    /// The condition of samples that hear `features`, `[batch, channels, time]`.
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

    /// Number of steps it was trained for.
    pub fn step(&self) -> u64 {
        self.state.step
    }

    /// The motion that the network's normalised `values`, `[channels, frames]`, say.
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

    /// Generates one sample per condition, as a batch; all conditions have the same number of
    /// frames. Sample i depends on `seed` and i alone, on the CPU to the bit, elsewhere up to rounding.
    /// Samples longer than those of training are drawn [in windows](Self::sample_whole).
    /// `on_step` is called with the number of sampling steps done and in total.
    ///
    /// # Errors
    /// If the sampler's settings are invalid, and [`Error::Interrupted`] after `Break`.
    pub fn sample(
        &self,
        conditions: &[AudioFeatures],
        sampling: &SamplingConfig,
        seed: u64,
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Vec<Sample>, Error> {
        let mut samples = Vec::with_capacity(conditions.len());
        let conditions = conditions.iter().cloned().zip(keys(seed, conditions.len()));
        self.sample_each(conditions, sampling, on_step, &mut |sample| {
            samples.push(sample);
            Ok(())
        })?;
        Ok(samples)
    }

    /// [`sample`](Self::sample) of any number of conditions, each with its [key](keys), of which
    /// one batch is in memory at a time; `take` gets the samples in order.
    ///
    /// # Errors
    /// As [`sample`](Self::sample), and of `take`, after which nothing more is drawn.
    pub fn sample_each(
        &self,
        mut conditions: impl ExactSizeIterator<Item = (AudioFeatures, Key)>,
        sampling: &SamplingConfig,
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
        take: &mut dyn FnMut(Sample) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (drawn, normalization) = (self.targets.channels(), self.state.normalization());
        let count = conditions.len();
        let all = count.div_ceil(BATCH);
        for done in 0..all {
            let (conditions, keys): (Vec<AudioFeatures>, Vec<Key>) =
                conditions.by_ref().take(BATCH).unzip();
            let frames = conditions.first().map_or(0, AudioFeatures::frames);
            let channels = self.config().data.audio_layout().channels();
            if let Some(other) = conditions.iter().find(|c| c.channels() != channels) {
                let found = other.channels();
                return Err(Error::usage(
                    format!("a condition of {found} audio features, the model hears {channels}"),
                    "read it in the layout of the run's `data.audio_features`",
                ));
            }
            if let Some(windows) = windows(self.config(), frames) {
                for (number, (audio, key)) in conditions.iter().zip(keys).enumerate() {
                    let whole = Whole {
                        audio,
                        windows: windows.clone(),
                        given: None,
                        path: None,
                        in_flight: WINDOWS_IN_FLIGHT,
                    };
                    let before = done.saturating_mul(BATCH).saturating_add(number);
                    take(
                        self.sample_whole(&whole, sampling, key, &mut |windows, of| {
                            let before = before.saturating_mul(of);
                            on_step(before.saturating_add(windows), count.saturating_mul(of))
                        })?,
                    )?;
                }
                continue;
            }
            let on_device = |values: Vec<f32>, channels: usize| -> Tensor<3> {
                let data = TensorData::new(values, [conditions.len(), channels, frames]);
                Tensor::from_data(data, &self.device)
            };
            let start = keys.iter().map(|key| key.at(0).normals(drawn * frames));
            let heard = conditions.iter().map(|cond| cond.as_slice().to_vec());
            let of_steps: Vec<Key> = keys.iter().map(|key| key.at(1)).collect();
            // Each sample as if it were drawn alone, to the bit.
            let x = batch_invariant(conditions.len(), || {
                let x = sample(
                    &self.diffusion,
                    &self.unet,
                    on_device(start.flatten().collect(), drawn),
                    &self.condition(on_device(heard.flatten().collect(), channels)),
                    &sampling.sampler,
                    &sampling.clip.range(normalization, drawn)?,
                    NoiseKeys::Samples(&of_steps),
                    &mut |step, total, _| {
                        let before = done.saturating_mul(total);
                        on_step(before.saturating_add(step), all.saturating_mul(total))
                    },
                )?;
                Ok::<_, Error>(match &self.decoder {
                    Some(decoder) => decoder.forward(x, None),
                    None => x,
                })
            })?;
            let values = x.try_into_vec_as::<f32>().expect("samples are float32");
            let width = self.decoder.as_ref().map_or(drawn, |_| CHANNELS);
            for values in values.chunks(width * frames) {
                let raw = match &self.decoder {
                    Some(_) => Phrase::from_channel_major(values, frames)?.into(),
                    None => self.predicted(values)?,
                };
                take(self.finished(raw, &vec![false; frames]))?;
            }
        }
        Ok(())
    }
}
