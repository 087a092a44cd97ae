//! Differences between several clips of one condition.

use kinegrad_motion::humanml::Features;
use kinegrad_motion::metrics::{multimodality, trajectory_diversity};
use kinegrad_train::Error;
use kinegrad_train::clips::evaluator::TextMotionEvaluator;
use kinegrad_train::evaluation::{Metrics, Number};
use serde::{Deserialize, Serialize};

use crate::GeneratedClip;

/// Number of clip pairs per condition; multimodality is their mean distance, as published.
const PAIRS: usize = 10;

/// Means over conditions with several clips each.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(super) struct VarietyReport {
    pub conditions: usize,
    /// Clips of each condition.
    pub repeats: usize,
    /// Meters.
    pub trajectory_diversity: Option<f64>,
    /// `None` without an evaluator.
    pub multimodality: Option<f64>,
}

impl VarietyReport {
    /// Measures `samples`, with `repeats` consecutive samples per condition.
    pub(super) fn compute(
        samples: &[GeneratedClip],
        repeats: usize,
        evaluator: Option<&dyn TextMotionEvaluator>,
        seed: u64,
    ) -> Result<Self, Error> {
        let ground = samples.iter().map(|sample| sample.ground.clone());
        let ground: Vec<_> = ground.collect();
        let paths: Vec<_> = ground.chunks(repeats).map(<[_]>::to_vec).collect();
        let clips: Option<Vec<&Features>> = samples.iter().map(|s| s.features.as_ref()).collect();
        let mut multimodality_of = None;
        if let (Some(evaluator), Some(clips)) = (evaluator, clips) {
            let embeddings = evaluator.motion_embeddings(&clips)?;
            let conditions = embeddings.chunks(repeats).map(<[_]>::to_vec);
            let conditions: Vec<_> = conditions.collect();
            multimodality_of = multimodality(&conditions, PAIRS.min(repeats), seed);
        }
        Ok(Self {
            conditions: paths.len(),
            repeats,
            trajectory_diversity: trajectory_diversity(&paths),
            multimodality: multimodality_of,
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
