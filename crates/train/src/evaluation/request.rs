//! Requests for an evaluation.

use std::rc::Rc;

use crate::TrainedModel;
use crate::checkpoint::SavedCheckpoint;
use crate::clips::evaluator::TextMotionEvaluator;
use crate::error::Error;
use crate::process_group::ProcessGroup;

/// The settings of an evaluation beyond the system's tables.
#[derive(Clone, Debug, Default)]
pub struct EvaluationRequest {
    /// Dataset whose held-out items are used, instead of the run's own.
    pub source: Option<String>,
    /// Checkpoint of the trajectory model for two-stage sampling.
    pub trajectory: Option<SavedCheckpoint>,
    /// The text-motion evaluator, opened by [`Systems::evaluate`](crate::Systems::evaluate).
    pub evaluator: Option<Rc<dyn TextMotionEvaluator>>,
    /// Seed of the noise.
    pub seed: u64,
    /// Compare the phrases' own music with silence and altered music.
    pub audio_ablation: bool,
    /// The processes that share sampling; all processes get the same results.
    pub group: Rc<ProcessGroup>,
}

impl EvaluationRequest {
    /// Rejects options that are not `accepted`.
    pub(crate) fn must_be_accepted(
        &self,
        accepted: &[&str],
        trained: &TrainedModel,
    ) -> Result<(), Error> {
        for (name, given, hint) in [
            (
                "audio_ablation",
                self.audio_ablation,
                "only models of phrases are conditioned on audio",
            ),
            (
                "trajectory_run",
                self.trajectory.is_some(),
                "only models of clips that reach goals take a path from a first stage",
            ),
        ] {
            if given && !accepted.contains(&name) {
                let recipe = &trained.config().train.recipe;
                let path = trained.path().display();
                let message = format!("option `{name}` with {path}, a run of recipe `{recipe}`");
                return Err(Error::usage(message, format!("{hint}: leave it out")));
            }
        }
        Ok(())
    }
}
