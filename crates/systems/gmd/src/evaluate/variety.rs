//! Differences between several clips of one condition.

use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::Features;
use kinegrad_motion::metrics::{multimodality, trajectory_diversity};
use serde::{Deserialize, Serialize};

use crate::GeneratedClip;
use kinegrad_train::Error;
use kinegrad_train::clips::evaluator::TextMotionEvaluator;
use kinegrad_train::evaluation::{Metrics, Number};

/// Pairs of clips of a condition whose distance multimodality is the mean of, as published.
const PAIRS: usize = 10;

/// Differences between several clips of one condition.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct VarietyReport {
    /// Number of conditions.
    pub conditions: usize,
    /// Clips of each.
    pub repeats: usize,
    /// [`trajectory_diversity`], metres.
    pub trajectory_diversity: Option<f64>,
    /// [`multimodality`], if the evaluator is given.
    pub multimodality: Option<f64>,
}

impl VarietyReport {
    /// Measures `samples`, `repeats` for each of the `goals`, one after the other.
    ///
    /// # Errors
    /// If features are of another layout than the evaluator's.
    pub(super) fn compute(
        samples: &[GeneratedClip],
        goals: &[&Goal],
        repeats: usize,
        evaluator: Option<&dyn TextMotionEvaluator>,
        seed: u64,
    ) -> Result<Self, Error> {
        let conditions = || samples.chunks(repeats).zip(goals);
        let paths = conditions().map(|(samples, goal)| {
            let cut = samples
                .iter()
                .map(|sample| sample.ground[..goal.frames].to_vec());
            cut.collect::<Vec<_>>()
        });
        let cut = conditions().flat_map(|(samples, goal)| {
            let features = samples.iter().map(|sample| sample.features.as_ref());
            features.map(|features| Some(features?.slice(0..goal.frames)))
        });
        let cut: Option<Vec<Features>> = cut.collect();
        let embeddings = match (evaluator, cut) {
            (Some(evaluator), Some(cut)) => {
                let embeddings = evaluator.motion_embeddings(&cut.iter().collect::<Vec<_>>())?;
                let conditions = embeddings.chunks(repeats).map(<[_]>::to_vec);
                Some(conditions.collect::<Vec<_>>())
            }
            _ => None,
        };
        Ok(Self {
            conditions: goals.len(),
            repeats,
            trajectory_diversity: trajectory_diversity(&paths.collect::<Vec<_>>()),
            multimodality: embeddings
                .and_then(|embeddings| multimodality(&embeddings, PAIRS.min(repeats), seed)),
        })
    }
}

impl Metrics for VarietyReport {
    fn rows(&self) -> Vec<Number> {
        Number::list([
            ("trajectory diversity", self.trajectory_diversity, " m"),
            ("multimodality", self.multimodality, ""),
        ])
    }
}
