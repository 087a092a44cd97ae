//! The record of a sample.

use std::path::PathBuf;

use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::path::{PathPlan, PathReport};
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_output::path_text;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Condition, GroundRecord, MeasuresRecord, SelectionRecord, condition};
use crate::TrainedModel;
use crate::checkpoint::Weights;
use crate::config::{ClipSample, ProductPrecision};

/// The record of a sample, which reproduces it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of kinegrad.
    pub kinegrad: String,
    /// Name of the run.
    pub run: String,
    /// The checkpoint's folder.
    #[serde(serialize_with = "path_text")]
    pub checkpoint: PathBuf,
    /// Steps it was trained for.
    pub step: u64,
    /// The weights: trained or EMA.
    pub weights: Weights,
    /// The system.
    pub system: String,
    /// The run's recipe.
    pub recipe: String,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of the sample, from 0, within its condition or, for clips guided to goals, its batch.
    /// The noise depends on `seed`, this number and the condition's name.
    pub index: usize,
    /// Length in frames.
    pub frames: usize,
    /// Frames per second.
    pub fps: f64,
    /// The sampler.
    pub sampler: SamplerRecord,
    /// Post-processing; `None` for models without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub post_processing: Option<PostProcessConfig>,
    /// The windows; `None` for a single one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub windows: Option<WindowsRecord>,
    /// The rollout, for recipe `flow`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout: Option<RolloutRecord>,
    /// The composition, for recipe `bpe_motion`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub composition: Option<CompositionRecord>,
    /// The path that the motion follows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathRecord>,
    /// The root's path on the ground, for clips of Guided Motion Diffusion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<GroundRecord>,
    /// The measures of the body, for models of clips.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<MeasuresRecord>,
    /// The measures of the phrase; `None` for other motion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phrase: Option<MeasuresRecord>,
    /// Beat alignment of the root's speed peaks with the beats of the audio features, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beat_alignment: Option<f64>,
    /// Distance between the embeddings of text and motion, if samples are selected by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text_distance: Option<f64>,
    /// The selection among several samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<SelectionRecord>,
    /// The conditions, a map by name; empty for an unconditional sample.
    #[serde(with = "condition::as_map")]
    pub condition: Vec<Condition>,
    /// The batch; omitted if irrelevant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub batch: Option<BatchRecord>,
}

/// A rollout, frame by frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RolloutRecord {
    /// True if every frame has the bone lengths of the history's last frame.
    pub constant_bones: bool,
    /// True if all poses share their noise.
    pub same_noise: bool,
    /// Network evaluations per frame; 0 in older records.
    #[serde(default)]
    pub evaluations_per_frame: f64,
    /// The texts, in order.
    #[serde(rename = "said")]
    pub prompts: Vec<PromptRecord>,
}

/// The segments of a composition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CompositionRecord {
    /// The denoising step from which positions were relative.
    pub bpe_denoising_step: i64,
    /// The texts, in order.
    #[serde(rename = "said")]
    pub prompts: Vec<PromptRecord>,
}

/// A path and the deviation of the motion from the path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathRecord {
    /// Its file.
    #[serde(serialize_with = "path_text")]
    pub file: PathBuf,
    /// The contents of the file.
    pub content: PathPlan,
    /// The table `evaluation.path`. `None` for models that follow the path as a goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<Value>,
    /// The deviation from the path.
    pub report: PathReport,
}

/// A text and its first frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PromptRecord {
    /// The frame, from 0.
    pub from: usize,
    /// The caption; `None` without a caption, or with an embedding only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

/// A batch of clips guided to goals; the guidance of each clip depends on the keyframes of all
/// clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatchRecord {
    /// Clips for each goal.
    pub count: usize,
    /// The goals, in order.
    pub goals: Vec<GoalRecord>,
}

/// A goal file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalRecord {
    /// Its path.
    #[serde(serialize_with = "path_text")]
    pub file: PathBuf,
    /// SHA-256 of its contents.
    pub sha256: String,
}

/// The overlapping windows of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WindowsRecord {
    /// Frames of each.
    pub frames: usize,
    /// Number of windows, evenly spread.
    pub count: usize,
    /// Windows per network call.
    pub in_flight: usize,
}

/// The sampler's settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SamplerRecord {
    /// Kind, steps, guidance scale, eta.
    #[serde(flatten)]
    pub settings: SamplerConfig,
    /// The clipping range of the predicted clean motion.
    pub clip: ClipSample,
    /// The bound of `clip = "symmetric"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip_range: Option<f64>,
    /// The precision of the networks' products.
    #[serde(default)]
    pub precision: ProductPrecision,
    /// The padding of a clip; only for clips of Guided Motion Diffusion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub padding: Option<Value>,
    /// Guidance and imputation; `None` without a goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steering: Option<Value>,
}

impl Record {
    /// The record of sample 0 of `trained`, without frames and conditions, which the system fills
    /// in.
    pub fn new(system: &str, trained: &TrainedModel, seed: u64) -> Self {
        let config = trained.config();
        Self {
            run: config.run.name.clone(),
            checkpoint: trained.path().to_path_buf(),
            step: trained.saved.state.step,
            weights: trained.weights,
            system: system.into(),
            recipe: config.train.recipe.clone(),
            seed,
            ..Self::blank(SamplerRecord {
                settings: config.sampling.sampler.clone(),
                clip: config.sampling.clip,
                clip_range: config.sampling.clip_range,
                precision: config.sampling.precision,
                padding: None,
                steering: None,
            })
        }
    }

    /// The record of a sample of no run.
    pub(super) fn blank(sampler: SamplerRecord) -> Self {
        Self {
            kinegrad: env!("CARGO_PKG_VERSION").into(),
            run: String::new(),
            checkpoint: PathBuf::new(),
            step: 0,
            weights: Weights::Ema,
            system: String::new(),
            recipe: String::new(),
            seed: 0,
            index: 0,
            frames: 0,
            fps: 0.0,
            sampler,
            post_processing: None,
            windows: None,
            rollout: None,
            composition: None,
            path: None,
            ground: None,
            body: None,
            phrase: None,
            beat_alignment: None,
            text_distance: None,
            selection: None,
            condition: Vec::new(),
            batch: None,
        }
    }

    /// False if the body or the root's path is far out of the bounds of the training motion.
    pub fn is_usable(&self) -> bool {
        let body = self.body.as_ref().is_some_and(|body| body.far);
        !body && !self.ground.as_ref().is_some_and(GroundRecord::is_far)
    }
}
