//! A text-motion evaluator from published files or a run, and its embeddings of clips and captions.

use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_data::humanml::read_word_vectors;
use kinegrad_kernels::Precision;
use kinegrad_models::Initializer;
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{FeatureError, FeatureLayout, Features, Root};
use kinegrad_motion::metrics::text_motion::{MAX_WORDS, Token, WordVectors};
use kinegrad_settings::counted;
use kinegrad_train::Error;
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::clips::evaluator::{EvaluatorFiles, TextMotionEvaluator};
use kinegrad_train::published::{load, mean_and_deviation, read_tensors};

use super::TextMotionTables;
use super::load::{encoders, word_vectors};
use crate::network::{PARTS, TextMotionConfig, TextMotionEncoders, UNIT_FRAMES};

/// Number of frames in the published evaluator's training.
const PUBLISHED_FRAMES: usize = 196;

const GROUP: usize = 32;

/// The evaluator, ready to use.
pub struct TextMotion {
    encoders: TextMotionEncoders,
    statistics: Statistics,
    words: WordVectors,
    /// Training length; shorter clips are padded with zeros after normalization.
    padded_frames: usize,
    device: Device,
}

impl TextMotion {
    /// Reads the published evaluator onto `device`, a device without gradients.
    ///
    /// # Errors
    /// If a file cannot be read, or has unsuitable contents.
    pub fn read(files: &EvaluatorFiles, device: &Device) -> Result<Self, Error> {
        let mut tensors = read_tensors(&files.weights)?;
        tensors.retain(|name, _| PARTS.iter().any(|part| name.starts_with(part)));
        let config = TextMotionConfig::of_weights(|name| Some(tensors.get(name)?.shape()));
        let encoders = config.init(&Initializer::new(0, device));
        let encoders = load(&files.weights, encoders, &tensors)?;
        let [mean, std] = mean_and_deviation(&files.mean, &files.std)?;
        let statistics = Statistics::new(mean, std, Some(Root::Relative))?;
        let words = read_word_vectors(&files.word_vectors)?;
        Self::new(encoders, statistics, words, PUBLISHED_FRAMES, device)
    }

    /// The evaluator of a checkpoint of recipe `text_motion`.
    ///
    /// # Errors
    /// If the checkpoint is damaged, or its word vectors cannot be read.
    pub fn of_run(
        saved: &SavedCheckpoint,
        weights: Weights,
        device: &Device,
    ) -> Result<Self, Error> {
        let state = &saved.state;
        let words = word_vectors(&state.config.own::<TextMotionTables>().words)?;
        let fresh = encoders(&state.config, words.width(), device);
        let encoders = saved.load(fresh, weights)?;
        let statistics = state.clip_statistics()?.clone();
        let padded_frames = state.config.data.target_frames;
        Self::new(encoders, statistics, words, padded_frames, device)
    }

    /// The evaluator of these parts, with the encoders on `device`. Statistics (with relative root)
    /// and number of frames come from the encoders' training.
    ///
    /// # Errors
    /// [`Error::Usage`] for parts that do not fit each other; [`Error::Features`] for statistics of
    /// the absolute root.
    pub fn new(
        encoders: TextMotionEncoders,
        statistics: Statistics,
        words: WordVectors,
        padded_frames: usize,
        device: &Device,
    ) -> Result<Self, Error> {
        if let Some(found @ Root::Absolute) = statistics.root {
            let expected = Root::Relative;
            return Err(FeatureError::WrongRoot { expected, found }.into());
        }
        let layout = FeatureLayout::of_channels(statistics.channels())?;
        let frame = layout.contacts().start;
        let (word, config) = (words.width(), encoders.config());
        let (frames, sentences) = ("movement_encoder", "text_encoder");
        for (what, found, reader, expected) in [
            (
                "a frame without contact flags",
                frame,
                frames,
                config.channels,
            ),
            ("a word vector", word, sentences, config.word_vector),
        ] {
            if found != expected {
                return Err(Error::usage(
                    format!("{what} has width {found}, but `{reader}` needs {expected}"),
                    "weights, mean and deviation, and word vectors must be those that were \
                     published together, for features of the same kind as the clips",
                ));
            }
        }
        Ok(Self {
            encoders,
            statistics,
            words,
            padded_frames,
            device: device.clone(),
        })
    }
}

impl TextMotionEvaluator for TextMotion {
    fn must_take(&self, layout: FeatureLayout) -> Result<(), Error> {
        let (expected, found) = (self.statistics.channels(), layout.channels());
        FeatureError::unless_equal("channels of a frame", expected, found)?;
        Ok(())
    }

    fn motion_embeddings(&self, clips: &[&Features]) -> Result<Vec<Vec<f64>>, Error> {
        let mut normalized = Vec::with_capacity(clips.len());
        for (clip, features) in clips.iter().enumerate() {
            let found = features.frames();
            if found < UNIT_FRAMES {
                let message = format!(
                    "clip {clip} (counted from 0) has {}, at least {UNIT_FRAMES} needed",
                    counted(found, "frame")
                );
                let hint = "leave out such clips; the published evaluation uses 40 frames or more";
                return Err(Error::usage(message, hint));
            }
            self.must_take(features.layout())?;
            normalized.push(self.statistics.normalize(features.to_relative().as_slice()));
        }
        let lengths: Vec<usize> = clips.iter().map(|clip| clip.frames()).collect();
        let padded = |frames: usize| frames.max(self.padded_frames);
        let channels = self.encoders.config().channels;
        Ok(in_groups(&lengths, padded, |group, lengths, padded| {
            let mut frames = vec![0.0; group.len() * channels * padded];
            let rows = frames.chunks_exact_mut(channels * padded);
            for ((row, &clip), &length) in rows.zip(group).zip(lengths) {
                let clip = normalized[clip].chunks_exact(length);
                for (row, channel) in row.chunks_exact_mut(padded).zip(clip) {
                    row[..length].copy_from_slice(channel);
                }
            }
            let frames = TensorData::new(frames, [group.len(), channels, padded]);
            let frames = Tensor::from_data(frames, &self.device);
            self.encoders.motions(frames, lengths)
        }))
    }

    fn text_embeddings(&self, captions: &[&[Token]]) -> Vec<Vec<f64>> {
        let sentences = captions.iter().map(|tokens| self.words.sentence(tokens));
        let sentences: Vec<_> = sentences.collect();
        let lengths: Vec<usize> = sentences.iter().map(Vec::len).collect();
        let (width, padded) = (self.words.width(), |_| MAX_WORDS + 2);
        in_groups(&lengths, padded, |group, lengths, padded| {
            let (mut vectors, mut classes) = (Vec::new(), Vec::new());
            for (row, &caption) in group.iter().enumerate() {
                for (vector, class) in &sentences[caption] {
                    vectors.extend_from_slice(vector);
                    classes.push(*class as i32);
                }
                vectors.resize((row + 1) * padded * width, 0.0);
                classes.resize((row + 1) * padded, 0);
            }
            let vectors = TensorData::new(vectors, [group.len(), padded, width]);
            let classes = TensorData::new(classes, [group.len(), padded]);
            let classes = Tensor::<2, Int>::from_data(classes, &self.device);
            let vectors = Tensor::from_data(vectors, &self.device);
            self.encoders.texts(vectors, classes, lengths)
        })
    }
}

/// Embeddings of items of `lengths`, in order. A batch has items of similar length and equal
/// `padded` length; `encode` gets indices, lengths and the padded length.
fn in_groups(
    lengths: &[usize],
    padded: impl Fn(usize) -> usize,
    encode: impl Fn(&[usize], &[usize], usize) -> Tensor<2>,
) -> Vec<Vec<f64>> {
    let padded = |item: usize| padded(lengths[item]);
    let mut order: Vec<usize> = (0..lengths.len()).collect();
    order.sort_by_key(|&item| lengths[item]);
    let alike = order.chunk_by(|&a, &b| padded(a) == padded(b));
    let mut embeddings = vec![Vec::new(); lengths.len()];
    for group in alike.flat_map(|alike| alike.chunks(GROUP)) {
        let lengths: Vec<usize> = group.iter().map(|&item| lengths[item]).collect();
        // Measures do not depend on the precision of the samples.
        let found = Precision::Float32.scope(|| encode(group, &lengths, padded(group[0])));
        let width = found.dims()[1];
        let values = found.try_into_vec_as::<f32>().expect("float32");
        for (&item, row) in group.iter().zip(values.chunks_exact(width)) {
            embeddings[item] = row.iter().map(|&value| f64::from(value)).collect();
        }
    }
    embeddings
}
