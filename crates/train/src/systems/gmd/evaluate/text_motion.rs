//! The published text-motion evaluator from its files.

use kinegrad_data::humanml::{Clip, read_word_vectors};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{Features, Root};
use kinegrad_motion::metrics::text_motion::{
    EvaluatorWeights, NamedArrays, TextMotionEvaluator, TextMotionReport, Token, WordVectors,
};
use pytorch_reader::Tensor;
use serde::Serialize;

use crate::error::Error;
use crate::published::{part_of, read_tensors, values_of, vector};
use crate::systems::gmd::EvaluatorFiles;

/// The evaluator, ready to measure.
pub struct TextMotion {
    evaluator: TextMotionEvaluator,
    words: WordVectors,
}

/// How drawn and real motion match their captions.
#[derive(Clone, Debug, Serialize)]
pub struct TextMotionReports {
    /// The drawn clips.
    pub drawn: TextMotionReport,
    /// The held-out clips.
    pub real: TextMotionReport,
}

impl TextMotion {
    /// Reads the evaluator.
    ///
    /// # Errors
    /// If a file cannot be read, or its contents do not fit; all differences are listed.
    pub fn read(files: &EvaluatorFiles) -> Result<Self, Error> {
        let tensors = read_tensors(&files.weights)?;
        let array = |tensor: &Tensor| -> Result<(Vec<usize>, Vec<f32>), Error> {
            let values = values_of(tensor).map_err(|reason| Error::Foreign {
                path: files.weights.clone(),
                reason: format!("`{}`: {reason}", tensor.name),
            })?;
            Ok((tensor.shape().to_vec(), values))
        };
        let part = |name: &str| -> Result<NamedArrays, Error> {
            let arrays = part_of(&tensors, name).into_iter();
            arrays
                .map(|(name, tensor)| Ok((name, array(&tensor)?)))
                .collect()
        };
        let weights = EvaluatorWeights {
            movement_encoder: part("movement_encoder")?,
            motion_encoder: part("motion_encoder")?,
            text_encoder: part("text_encoder")?,
        };
        let (mean, std) = (vector(&files.mean)?, vector(&files.std)?);
        let statistics = Statistics::new(mean, std, Some(Root::Relative))?;
        Ok(Self {
            evaluator: TextMotionEvaluator::new(&weights, statistics)?,
            words: read_word_vectors(&files.word_vectors)?,
        })
    }

    /// Measures drawn clips, one for each of the `real` ones, by the first caption of each.
    ///
    /// # Errors
    /// If features are of another layout than the evaluator's.
    pub fn reports(
        &self,
        drawn: &[&Features],
        real: &[&Clip],
        seed: u64,
    ) -> Result<TextMotionReports, Error> {
        let captions: Vec<&[Token]> = real
            .iter()
            .map(|clip| clip.captions.first().map_or(&[][..], |c| &c.tokens))
            .collect();
        let texts = self.evaluator.text_embeddings(&captions, &self.words)?;
        let truths: Vec<&Features> = real.iter().map(|clip| &clip.features).collect();
        let truths = self.evaluator.motion_embeddings(&truths)?;
        let drawn = self.evaluator.motion_embeddings(drawn)?;
        Ok(TextMotionReports {
            drawn: TextMotionReport::compute(&texts, &drawn, &truths, seed),
            real: TextMotionReport::compute(&texts, &truths, &truths, seed),
        })
    }
}
