//! Requests for an evaluation.

use std::path::PathBuf;
use std::rc::Rc;

use kinegrad_data::{MAX_FRAMES, MIN_FRAMES};
use kinegrad_settings::in_range;

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
    /// Folder of songs without motion, or a song, instead of held-out phrases.
    pub songs: Option<PathBuf>,
    /// Most samples in total, instead of the numbers in the config.
    pub num_samples: Option<usize>,
    /// Most frames of a sample: phrases are cut, songs are divided.
    pub num_frames: Option<usize>,
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
                "songs",
                self.songs.is_some(),
                "only models of phrases are conditioned on audio",
            ),
            (
                "num_samples",
                self.num_samples.is_some(),
                "the table `evaluation` sets the number of samples of this recipe",
            ),
            (
                "num_frames",
                self.num_frames.is_some(),
                "samples of this recipe have the length of their items",
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
        let frames = self.num_frames.unwrap_or(MIN_FRAMES);
        in_range("option num_frames", frames, MIN_FRAMES..=MAX_FRAMES)?;
        in_range(
            "option num_samples",
            self.num_samples.unwrap_or(1),
            1..=65_536,
        )?;
        for (name, given) in [
            ("songs", self.songs.is_some()),
            ("num_samples", self.num_samples.is_some()),
            ("num_frames", self.num_frames.is_some()),
        ] {
            if given && self.audio_ablation {
                return Err(Error::usage(
                    format!("option `{name}` with option `audio_ablation`"),
                    "the audio ablation uses the held-out phrases of the dataset as they are",
                ));
            }
        }
        if self.songs.is_some() && self.source.is_some() {
            return Err(Error::usage(
                "option `songs` with option `source`",
                "samples are generated for songs, or for the phrases of a dataset",
            ));
        }
        Ok(())
    }
}
