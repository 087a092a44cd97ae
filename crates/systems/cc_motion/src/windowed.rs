//! Sampling motion in overlapping windows: whole songs, and motion with known frames.
//!
//! The windows have the training length and are sampled jointly. After each prediction, the
//! predicted clean windows are stitched to one motion ([`kinegrad_motion::stitch`]), and each
//! window continues from its part of the motion. The noise is recomputed to fit the part and the
//! window's state. Frames shared by several windows have the same noise. The number of windows in
//! one network call bounds the memory.

use std::ops::{ControlFlow, Range};

use burn::tensor::Tensor;
use kinegrad_data::AudioFeatures;
use kinegrad_diffusion::{
    NoiseKeys, Prediction, PredictionType, Time, guided, noise_of_parts, sample_with,
};
use kinegrad_kernels::{batch_invariant, host_values};
use kinegrad_motion::coherence::{
    fit_heading, fit_orientation, fit_trajectory, heading_confidence,
};
use kinegrad_motion::derivatives::make_sign_continuous;
use kinegrad_motion::heading_alignment::HeadingAlignment;
use kinegrad_motion::postprocess::derive_angular_velocity;
use kinegrad_motion::stitch::{self, Layout, Windows};
use kinegrad_motion::{Phrase, Statistics};
use kinegrad_random::Key;
use kinegrad_train::Error;
use kinegrad_train::config::SamplingConfig;
use kinegrad_train::sampling::KnownFrames;

use super::generator::{Generator, Sample};
use super::path::PhrasePath;
use crate::network::decoder::{Coherence, MotionDecoder};

/// Default number of windows in one network call.
pub const WINDOWS_IN_FLIGHT: usize = 8;

/// A motion to be sampled in windows.
#[derive(Clone, Debug)]
pub struct WindowedSampling<'a> {
    /// Audio condition of all frames.
    pub audio: &'a AudioFeatures,
    /// Windows of the motion; each window is conditioned on its part of the audio.
    pub windows: Windows,
    /// Known frames.
    pub known: Option<&'a KnownFrames>,
    /// The path that the motion follows.
    pub path: Option<&'a PhrasePath>,
    /// Number of windows in one network call. More windows are faster and need more memory. On the
    /// CPU, the motion does not depend on this number, to the bit.
    pub in_flight: usize,
}

impl WindowedSampling<'_> {
    /// Ranges of windows for the network calls.
    fn batches(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let (windows, in_flight) = (self.windows.len(), self.in_flight.max(1));
        let firsts = (0..windows).step_by(in_flight);
        firsts.map(move |first| first..(first + in_flight).min(windows))
    }
}

impl Generator {
    /// Generates a motion in windows from the noise of `key`. After each network call, `on_windows`
    /// gets the number of processed windows and their total number over all steps.
    ///
    /// # Errors
    /// If the sampler's settings are invalid, and [`Error::Interrupted`] after `Break`.
    pub fn sample_windowed(
        &self,
        windowed: &WindowedSampling<'_>,
        sampling: &SamplingConfig,
        key: Key,
        on_windows: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Sample, Error> {
        let physical = windowed.known.map(KnownFrames::known);
        let normalized = physical.as_ref().map(|known| self.normalized(known));
        let frames = windowed.windows.frames();
        let mut latents = self.latents(windowed, normalized.as_ref(), sampling, key, on_windows)?;
        let (raw, confidence) = match &self.decoder {
            None => self.predicted(&self.stitched(windowed, &mut latents, normalized.as_ref()))?,
            Some(decoder) => (
                self.decoded(decoder, windowed, physical.as_ref(), &latents)?,
                vec![1.0; frames],
            ),
        };
        let is_known = is_known(physical.as_ref(), frames);
        let mut sample = self.finished(raw, &confidence, &is_known);
        for motion in [&mut sample.raw, &mut sample.motion] {
            if let Some(known) = windowed.known {
                known.put_into(motion);
            }
            if let Some(path) = windowed.path {
                path.finish(motion);
            }
        }
        Ok(sample)
    }

    /// Known frames of a phrase in the channels and units of the network.
    fn normalized(&self, known: &stitch::KnownFrames) -> stitch::KnownFrames {
        let frames = known.is_known.len();
        let phrase = Phrase::from_channel_major(&known.values, frames).expect("25 channels");
        let rows = self.targets.encode(phrase.as_slice());
        let channels = self.targets.channels();
        let Statistics { mean, std, .. } = self.state.normalization();
        let place = |index: usize| (index / frames, index % frames);
        let values = (0..channels * frames).map(place).map(|(channel, t)| {
            let value = f64::from(rows[t * channels + channel]);
            ((value - mean[channel]) / std[channel]) as f32
        });
        stitch::KnownFrames {
            values: values.collect(),
            is_known: known.is_known.clone(),
        }
    }

    /// Stitches predicted windows to one motion; each window becomes its part of the motion.
    fn stitched(
        &self,
        windowed: &WindowedSampling<'_>,
        values: &mut [f32],
        known: Option<&stitch::KnownFrames>,
    ) -> Vec<f32> {
        let turning = HeadingAlignment {
            layout: Layout::Predicted(self.targets),
            statistics: Some(self.state.normalization()),
        };
        self.turned_and_stitched(turning, windowed, values, known)
    }

    /// Stitches windows to one motion. Each window becomes its part of the motion, with its own
    /// position and heading. Windows of a model trained on one heading, and windows along a path,
    /// are not rotated.
    fn turned_and_stitched(
        &self,
        turning: HeadingAlignment<'_>,
        windowed: &WindowedSampling<'_>,
        values: &mut [f32],
        known: Option<&stitch::KnownFrames>,
    ) -> Vec<f32> {
        let windows = &windowed.windows;
        if !self.state.config.data.augment.rotate_yaw || windowed.path.is_some() {
            return windows.stitch(values, known, turning.layout);
        }
        let angles = turning.angles(windows, values, known);
        turning.turn(windows, values, &angles);
        let motion = windows.stitch(values, known, turning.layout);
        let back: Vec<f64> = angles.iter().map(|angle| -angle).collect();
        turning.turn(windows, values, &back);
        motion
    }

    /// The normalized denoised windows, `[windows, channels, frames of a window]`.
    fn latents(
        &self,
        windowed: &WindowedSampling<'_>,
        known: Option<&stitch::KnownFrames>,
        sampling: &SamplingConfig,
        key: Key,
        on_windows: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Vec<f32>, Error> {
        let (windows, config) = (&windowed.windows, &sampling.sampler);
        let shape = [windows.len(), self.targets.channels(), windows.length()];
        let clip = sampling.clip_bounds(self.state.normalization(), shape[1])?;
        let all = sampling.sampler.network_evaluations() * windows.len();
        let mut done = 0;
        let mut predict = |x: Tensor<3>, time: &[Time]| {
            let timesteps: Vec<usize> = time.iter().map(|time| time.timestep()).collect();
            let mut predicted = Vec::with_capacity(shape.iter().product());
            for batch in windowed.batches() {
                let features = batch.clone().map(|window| {
                    let part = windowed.audio.slice(windows.of(window));
                    part.as_slice().to_vec()
                });
                let cond = [batch.len(), windowed.audio.channels(), windows.length()];
                let cond = self.condition(self.on_device(features.flatten().collect(), cond));
                let x = x.clone().narrow(0, batch.start, batch.len());
                // Each window equals the window sampled alone, to the bit.
                let prediction = batch_invariant(batch.len(), || {
                    let time = &time[batch.clone()];
                    let scales = config.guidance(time[0].timestep());
                    let output = guided(&self.unet, x.clone(), time, &cond, scales);
                    let timesteps = &timesteps[batch.clone()];
                    Prediction::new(&self.diffusion, output, x, timesteps, &clip)
                })?;
                predicted.extend(host_values(prediction.x_start));
                done += batch.len();
                if on_windows(done, all).is_break() {
                    return Err(kinegrad_diffusion::Error::Stopped);
                }
            }
            if let Some(path) = windowed.path {
                let statistics = self.state.normalization();
                path.lead(&mut predicted, windows, statistics, timesteps[0]);
            }
            self.stitched(windowed, &mut predicted, known);
            let x_start = self.on_device(predicted, shape);
            // The equivalent output for this prediction type.
            let model_output = self.diffusion.convert(
                x_start.clone(),
                x.clone(),
                &timesteps,
                PredictionType::Sample,
                self.diffusion.config.prediction_type,
            );
            Ok(Prediction {
                x_t: x,
                x_start,
                model_output,
                clipped: true,
                steered: None,
            })
        };
        let [_, channels, time] = shape;
        let starts = windows.starts();
        let noise = noise_of_parts(key.at(0), starts, [channels, time]);
        let keys = NoiseKeys::Parts {
            key: key.at(1),
            starts,
        };
        let x = sample_with(
            &self.diffusion,
            &mut predict,
            self.on_device(noise, shape),
            config,
            keys,
            &mut |_, _, _| ControlFlow::Continue(()),
        )?;
        Ok(host_values(x))
    }

    /// The motion of latent windows. Each window is decoded in its own coordinates, as in training.
    /// The coherent trajectory covers the whole motion.
    fn decoded(
        &self,
        decoder: &MotionDecoder,
        windowed: &WindowedSampling<'_>,
        known: Option<&stitch::KnownFrames>,
        latents: &[f32],
    ) -> Result<Phrase, Error> {
        let windows = &windowed.windows;
        let channels = self.targets.channels();
        let a_window = channels * windows.length();
        let mut decoded = Vec::with_capacity(latents.len());
        for batch in windowed.batches() {
            let latent = latents[batch.start * a_window..batch.end * a_window].to_vec();
            let latent = self.on_device(latent, [batch.len(), channels, windows.length()]);
            let motion = batch_invariant(batch.len(), || decoder.frames(latent, None));
            decoded.extend(host_values(motion));
        }
        let turning = HeadingAlignment {
            layout: Layout::Phrase,
            statistics: None,
        };
        let all = self.turned_and_stitched(turning, windowed, &mut decoded, known);
        let mut motion = Phrase::from_channel_major(&all, windows.frames())?;
        let coherence = decoder.coherence();
        if coherence != Coherence::None {
            let is_known = is_known(known, windows.frames());
            let std = &self.statistics().std;
            fit_trajectory(&mut motion, std, &is_known);
            if coherence == Coherence::Full {
                let confidence = heading_confidence(&motion);
                fit_heading(&mut motion, std, &is_known, &confidence);
                fit_orientation(&mut motion, std, &is_known);
            }
        }
        let units = (0..motion.frames()).map(|t| motion.quaternion(t).normalised());
        let mut quaternions: Vec<_> = units.collect();
        if coherence != Coherence::None {
            make_sign_continuous(&mut quaternions);
        }
        for (t, quaternion) in quaternions.into_iter().enumerate() {
            motion.set_quaternion(t, quaternion);
        }
        if coherence != Coherence::None {
            // As in the decoder for a phrase: the derivative of the quaternions.
            derive_angular_velocity(&mut motion);
        }
        Ok(motion)
    }
}

/// True for known frames among `frames` frames.
fn is_known(known: Option<&stitch::KnownFrames>, frames: usize) -> Vec<bool> {
    known.map_or_else(|| vec![false; frames], |known| known.is_known.clone())
}
