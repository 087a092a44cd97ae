//! The held-out phrases, in batches, with noise that is the same for every run.

use std::ops::Range;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{Phrase, collate_validation};
use kinegrad_motion::TrainingStatistics;
use kinegrad_random::{Key, Purpose};

use super::Inputs;
use crate::config::ValidationConfig;

/// What a recipe is measured on.
pub struct HeldOut {
    pub(super) phrases: Vec<Arc<Phrase>>,
    pub(super) statistics: Arc<TrainingStatistics>,
    pub(super) draws: usize,
    batch_size: usize,
    target_frames: usize,
}

impl HeldOut {
    /// `phrases`, cut or padded to `target_frames`.
    pub fn new(
        phrases: Vec<Arc<Phrase>>,
        statistics: Arc<TrainingStatistics>,
        config: &ValidationConfig,
        target_frames: usize,
    ) -> Self {
        Self {
            phrases,
            statistics,
            draws: config.draws,
            batch_size: config.batch_size,
            target_frames,
        }
    }

    /// Each batch, with the indices of its phrases.
    pub(super) fn batches(&self, device: &Device) -> impl Iterator<Item = (Range<usize>, Inputs)> {
        let all = self.phrases.len();
        (0..all).step_by(self.batch_size).map(move |start| {
            let range = start..(start + self.batch_size).min(all);
            let phrases = &self.phrases[range.clone()];
            let batch = collate_validation(phrases, &self.statistics, self.target_frames);
            (range, Inputs::new(&batch, device))
        })
    }

    /// Noise keyed by phrase and draw alone, so that runs with other seeds compare too.
    pub(super) fn noise(&self, range: Range<usize>, draw: u64, like: &Tensor<3>) -> Tensor<3> {
        let [_, channels, time] = like.dims();
        let values: Vec<f32> = self.phrases[range]
            .iter()
            .flat_map(|phrase| {
                let key = Key::new(0, Purpose::Validation).named(&phrase.id);
                key.at(draw).normals(channels * time)
            })
            .collect();
        Tensor::from_data(TensorData::new(values, like.dims()), &like.device())
    }
}
