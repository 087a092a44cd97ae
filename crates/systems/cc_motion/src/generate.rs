//! Generating phrases from a checkpoint.

use std::ops::ControlFlow;

use kinegrad_data::AudioFeatures;
use kinegrad_diffusion::{NoiseKeys, sample};
use kinegrad_kernels::batch_invariant;
use kinegrad_motion::Phrase;
use kinegrad_motion::phrase::CHANNELS;
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::counted;
use kinegrad_train::config::SamplingConfig;
use kinegrad_train::sampling::Needs;
use kinegrad_train::{Error, TrainedModel, memory};

use super::lengths::windows;
use super::load::footprint;
use super::windowed::{WINDOWS_IN_FLIGHT, WindowedSampling};

pub use super::generator::{Generator, Sample};

/// Maximum batch size.
const BATCH: usize = 32;

/// The memory of a batch of `count` samples of `frames` frames.
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
        work: format!(
            "sampling {} of {}",
            counted(batch, "phrase"),
            counted(frames, "frame")
        ),
        bytes: networks.of_sampling(batch, false, trained.on_host),
        hint,
    })
}

/// Rejects `count` samples of `frames` frames in each of `processes` if a batch exceeds the memory.
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
    /// Generates one sample per condition, as a batch; all conditions have the same number of
    /// frames. Sample i depends only on `seed` and i: exactly on the CPU, up to rounding on other
    /// devices. Samples longer than in training are sampled [in windows](Self::sample_windowed).
    /// `on_step` gets the numbers of finished and of all sampling steps.
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

    /// [`sample`](Self::sample) for any number of conditions with their [keys](keys). One batch is
    /// in memory at a time; `take` gets the samples in order.
    ///
    /// # Errors
    /// As [`sample`](Self::sample), and errors of `take`, which end sampling.
    pub fn sample_each(
        &self,
        mut conditions: impl ExactSizeIterator<Item = (AudioFeatures, Key)>,
        sampling: &SamplingConfig,
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
        take: &mut dyn FnMut(Sample) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (channels, normalization) = (self.targets.channels(), self.state.normalization());
        let count = conditions.len();
        let all = count.div_ceil(BATCH);
        for done in 0..all {
            let (conditions, keys): (Vec<AudioFeatures>, Vec<Key>) =
                conditions.by_ref().take(BATCH).unzip();
            let frames = conditions.first().map_or(0, AudioFeatures::frames);
            let cond_channels = self.config().data.audio_layout().channels();
            if let Some(other) = conditions.iter().find(|c| c.channels() != cond_channels) {
                let found = other.channels();
                return Err(Error::usage(
                    format!(
                        "a condition of {found} audio features, the model takes {cond_channels}"
                    ),
                    "read it in the layout of the run's `data.audio_features`",
                ));
            }
            if let Some(windows) = windows(self.config(), frames) {
                for (number, (audio, key)) in conditions.iter().zip(keys).enumerate() {
                    let windowed = WindowedSampling {
                        audio,
                        windows: windows.clone(),
                        known: None,
                        path: None,
                        in_flight: WINDOWS_IN_FLIGHT,
                    };
                    let before = done.saturating_mul(BATCH).saturating_add(number);
                    let on_windows = &mut |windows, of| {
                        let before = before.saturating_mul(of);
                        on_step(before.saturating_add(windows), count.saturating_mul(of))
                    };
                    take(self.sample_windowed(&windowed, sampling, key, on_windows)?)?;
                }
                continue;
            }
            let on_device = |values: Vec<f32>, channels: usize| {
                self.on_device(values, [conditions.len(), channels, frames])
            };
            let start = keys.iter().map(|key| key.at(0).normals(channels * frames));
            let features = conditions.iter().map(|cond| cond.as_slice().to_vec());
            let of_steps: Vec<Key> = keys.iter().map(|key| key.at(1)).collect();
            // Each sample equals the sample generated alone, to the bit.
            let x = batch_invariant(conditions.len(), || {
                let x = sample(
                    &self.diffusion,
                    &self.unet,
                    on_device(start.flatten().collect(), channels),
                    &self.condition(on_device(features.flatten().collect(), cond_channels)),
                    &sampling.sampler,
                    &sampling.clip_bounds(normalization, channels)?,
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
            let width = self.decoder.as_ref().map_or(channels, |_| CHANNELS);
            for values in values.chunks(width * frames) {
                let (raw, confidence) = match &self.decoder {
                    Some(_) => (
                        Phrase::from_channel_major(values, frames)?,
                        vec![1.0; frames],
                    ),
                    None => self.predicted(values)?,
                };
                take(self.finished(raw, &confidence, &vec![false; frames]))?;
            }
        }
        Ok(())
    }
}
