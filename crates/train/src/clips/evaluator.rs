//! The text-motion evaluator: embeddings of captions and motions, close for matching pairs.

use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;

use kinegrad_data::humanml::{Clip, ClipLabels};
use kinegrad_motion::humanml::{FeatureLayout, Features};
use kinegrad_motion::metrics::text_motion::{TextMotionReport, Token};
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::{InvalidSetting, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checkpoint::SavedCheckpoint;
use crate::error::Error;

/// The table `evaluation.evaluator`: the text-motion evaluator. An empty table means no evaluator.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluatorFiles {
    /// Run or checkpoint of recipe `text_motion`, instead of the files of the published evaluator.
    pub run: PathBuf,
    /// Weights with `movement_encoder`, `motion_encoder` and `text_encoder`.
    pub weights: PathBuf,
    /// `.npy` files of the mean and deviation for normalizing features with a relative root.
    pub mean: PathBuf,
    /// See `mean`.
    pub std: PathBuf,
    /// Word vectors as safetensors (docs/dataset.md).
    pub word_vectors: PathBuf,
}

impl EvaluatorFiles {
    /// True if any file of the published evaluator is given.
    pub fn has_files(&self) -> bool {
        let mut named = self.named().into_iter();
        named.any(|(_, path)| !path.as_os_str().is_empty())
    }

    fn named(&self) -> [(&'static str, &PathBuf); 4] {
        [
            ("weights", &self.weights),
            ("mean", &self.mean),
            ("std", &self.std),
            ("word_vectors", &self.word_vectors),
        ]
    }

    /// # Errors
    /// Names the missing file, or `run` if files are given too.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        if !self.has_files() {
            return Ok(());
        }
        for (name, path) in self.named() {
            let allowed = "a file: the evaluator needs weights, mean, std and word_vectors";
            require(!path.as_os_str().is_empty(), name, "empty", allowed)?;
        }
        let none = self.run.as_os_str().is_empty();
        require(none, "run", "given together with files", "one of the two")
    }
}

/// The weights of an evaluator.
#[derive(Clone, Copy, Debug)]
pub enum EvaluatorSource<'a> {
    /// A trained run.
    Run(&'a SavedCheckpoint),
    /// The published files.
    Files(&'a EvaluatorFiles),
}

/// The match of generated and real motion with their captions.
#[derive(Clone, Debug, Serialize)]
pub struct TextMotionReports {
    /// The generated clips.
    pub sampled: TextMotionReport,
    /// The held-out clips.
    pub real: TextMotionReport,
}

/// A text-motion evaluator.
pub trait TextMotionEvaluator {
    /// Rejects features of a layout other than the evaluator's.
    ///
    /// # Errors
    /// [`Error::Features`] if the skeleton differs from that of the statistics.
    fn must_take(&self, layout: FeatureLayout) -> Result<(), Error>;

    /// The embedding of each clip, `[clips, width]`. Both root representations are accepted.
    ///
    /// # Errors
    /// [`Error::Usage`] for a clip that is too short; [`Error::Features`] if the skeleton differs
    /// from that of the statistics.
    fn motion_embeddings(&self, clips: &[&Features]) -> Result<Vec<Vec<f64>>, Error>;

    /// The embedding of each caption, `[captions, width]`, computed from the caption's first words.
    fn text_embeddings(&self, captions: &[&[Token]]) -> Vec<Vec<f64>>;

    /// Evaluates generated clips, with the captions of `clips`. Generated clip i has the length of
    /// `real` clip i. `seed` selects the pools for ranking captions and the pairs for diversity.
    ///
    /// # Errors
    /// If the layout of the features differs from the evaluator's.
    fn reports(
        &self,
        generated: &[Features],
        real: &[Features],
        clips: &[&Clip],
        labels: &ClipLabels,
        seed: u64,
    ) -> Result<TextMotionReports, Error> {
        // Clips with neighboring ids are similar, so pools take a random order.
        let order = Key::new(seed, Purpose::Pools).permutation(clips.len());
        let words = |&clip: &usize| match clips[clip].caption() {
            Some(caption) => caption.words(),
            None => Cow::Borrowed(&[][..]),
        };
        let captions: Vec<Cow<[Token]>> = order.iter().map(words).collect();
        let captions: Vec<&[Token]> = captions.iter().map(AsRef::as_ref).collect();
        let texts = self.text_embeddings(&captions);
        let in_order = |of: &[Features]| -> Result<_, Error> {
            let clips: Vec<&Features> = order.iter().map(|&clip| &of[clip]).collect();
            self.motion_embeddings(&clips)
        };
        let (truths, generated) = (in_order(real)?, in_order(generated)?);
        let labels = order.iter().map(|&clip| labels.get(&clips[clip].id));
        let labels: Vec<_> = labels.collect();
        let report = |motions: &[Vec<f64>]| {
            let report = TextMotionReport::compute(&texts, motions, &truths, seed);
            report.with_labels(&texts, motions, &labels)
        };
        Ok(TextMotionReports {
            sampled: report(&generated),
            real: report(&truths),
        })
    }
}

impl fmt::Debug for dyn TextMotionEvaluator + '_ {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TextMotionEvaluator")
    }
}
