//! The tables of a config that are this system's own, and what must hold of them.

use std::path::PathBuf;

use kinegrad_data::DataKind;
use kinegrad_diffusion::DiffusionConfig;
use kinegrad_models::ModelConfig;
use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisError, EmphasisKind};
use serde::{Deserialize, Serialize};

use super::TRAJECTORY;
use super::networks::channels_of;
use crate::config::{Clip, Config, ConfigError, SystemTables};
use crate::error::Error;

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdConfig {
    /// What a fine-tuning starts from.
    pub init: GmdInitConfig,
    /// The denoiser.
    pub model: ModelConfig,
    /// The space that a motion model works in.
    pub emphasis: EmphasisConfig,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// The loss.
    pub loss: GmdLossConfig,
    /// What an evaluation asks for.
    pub evaluation: GmdEvaluationConfig,
}

/// The table `init`: what a fine-tuning starts from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdInitConfig {
    /// Run or checkpoint of the same recipe; its averaged weights are taken, and its network,
    /// process, space and statistics.
    pub diffusion: PathBuf,
}

/// The table `loss`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdLossConfig {
    /// Of a motion model without a projection: the first four channels (root rotation, x, z and
    /// height) count by the square of this factor (Guided Motion Diffusion, appendix C.1).
    pub trajectory_scale: f64,
}

impl Default for GmdLossConfig {
    fn default() -> Self {
        Self {
            trajectory_scale: 1.0,
        }
    }
}

/// The table `evaluation`: what `kinegrad eval` asks of the model, on the way of held-out clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdEvaluationConfig {
    /// Held-out clips with a goal each.
    pub goals: usize,
    /// Key frames of each goal.
    pub keyframes: usize,
    /// Obstacles on the way of each goal, of which then the last key frame alone is asked for.
    pub obstacles: usize,
    /// The published text-motion evaluator, for R-precision and FID: all of its files, or none.
    pub evaluator: EvaluatorFiles,
}

impl Default for GmdEvaluationConfig {
    fn default() -> Self {
        Self {
            goals: 20,
            keyframes: 5,
            obstacles: 0,
            evaluator: EvaluatorFiles::default(),
        }
    }
}

/// The table `evaluation.evaluator`: where the evaluator's parts lie; empty where there is none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluatorFiles {
    /// Weights with `movement_encoder`, `motion_encoder` and `text_encoder`.
    pub weights: PathBuf,
    /// `.npy` files of the mean and deviation that it normalises by, of the relative root.
    pub mean: PathBuf,
    /// See `mean`.
    pub std: PathBuf,
    /// Word vectors as safetensors (docs/dataset.md).
    pub word_vectors: PathBuf,
}

impl EvaluatorFiles {
    /// Whether any file is named.
    pub fn is_given(&self) -> bool {
        self.named()
            .iter()
            .any(|(_, path)| !path.as_os_str().is_empty())
    }

    fn named(&self) -> [(&'static str, &PathBuf); 4] {
        [
            ("weights", &self.weights),
            ("mean", &self.mean),
            ("std", &self.std),
            ("word_vectors", &self.word_vectors),
        ]
    }
}

impl SystemTables for GmdConfig {
    const PASSED_OVER: &'static str = include_str!("passed_over.toml");

    fn resolved(self) -> Self {
        Self {
            model: self.model.resolved(),
            ..self
        }
    }
}

/// Refuses what this system cannot work with.
///
/// # Errors
/// Names the first key with a bad value.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own = GmdConfig::of(config)?;
    let recipe = &config.train.recipe;
    own.diffusion.validate()?;
    if !matches!(
        config.data.kind,
        DataKind::Humanml3d | DataKind::SyntheticWalks
    ) {
        let allowed = format!("\"humanml3d\" or \"synthetic_walks\" for recipe `{recipe}`");
        let found = "a kind of phrases";
        return Err(ConfigError::range("data.kind", found, allowed).into());
    }
    own.model.backbone(channels_of(config))?;
    if let Some(most) = own.model.resolved().padded_frames
        && config.data.target_frames > most
    {
        let allowed = format!("at most `model.padded_frames` ({most})");
        let found = config.data.target_frames;
        return Err(ConfigError::range("data.target_frames", found, allowed).into());
    }
    let timesteps = own.diffusion.num_train_timesteps;
    config.sampling.sampler.validate(timesteps)?;
    if config.sampling.clip == Clip::TrainingRange {
        let allowed = "\"none\", \"six\" or \"unit\": the ranges of joint features are not kept";
        return Err(ConfigError::range("sampling.clip", "\"training_range\"", allowed).into());
    }
    own.emphasis.validate().map_err(|error| match error {
        EmphasisError::InvalidSetting {
            key,
            found,
            allowed,
        } => ConfigError::range(format!("emphasis.{key}"), found, allowed).into(),
        other => Error::from(other),
    })?;
    let scale = own.loss.trajectory_scale;
    ConfigError::unless_positive("loss.trajectory_scale", scale)?;
    let projects = own.emphasis.kind != EmphasisKind::None;
    if recipe == TRAJECTORY && projects {
        let allowed = "\"none\": the trajectory model's four channels are not projected";
        return Err(ConfigError::range("emphasis.kind", "a projection", allowed).into());
    }
    if scale != 1.0 && (projects || recipe == TRAJECTORY) {
        let allowed = "1 in a projected space, where no channel is the trajectory's, and in recipe \
                       `gmd_trajectory`, where all are";
        return Err(ConfigError::range("loss.trajectory_scale", scale, allowed).into());
    }
    let evaluation = &own.evaluation;
    if evaluation.goals == 0 {
        return Err(ConfigError::range("evaluation.goals", 0, "1 or more").into());
    }
    let files = evaluation.evaluator.named();
    let missing = files.iter().find(|(_, path)| path.as_os_str().is_empty());
    if let (true, Some((name, _))) = (evaluation.evaluator.is_given(), missing) {
        let key = format!("evaluation.evaluator.{name}");
        let allowed = "a file: the evaluator needs weights, mean, std and word_vectors";
        return Err(ConfigError::range(key, "empty", allowed).into());
    }
    config.sampling.steering.validate()
}

/// What is doubtful.
pub(super) fn warnings(config: &Config) -> Option<String> {
    let overtrains = config.train.recipe == TRAJECTORY
        && (config.train.patience == 0 || config.validation.every_steps == 0);
    overtrains.then(|| {
        "a trajectory model that has learned its paths by heart resists guidance, and this run \
         never stops early: set `train.patience` and `validation.every_steps`"
            .to_string()
    })
}
