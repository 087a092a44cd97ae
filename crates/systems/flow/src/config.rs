//! The system's own config tables and their validation.

use crate::network::FlowConfig;
use kinegrad_data::Crop;
use kinegrad_diffusion::{FlowPrediction, must_suit_flow};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_motion::humanml::{NextPose, Root};
use kinegrad_settings::{in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{RECIPE, RolloutReport};
use kinegrad_train::Error;
use kinegrad_train::clips::captions::CaptionsConfig;
use kinegrad_train::clips::settings::must_be_of_clips;
use kinegrad_train::config::{ClipSample, Config, ModelTable, NetworkKind, SystemTables};

/// Values of the common tables.
pub(super) const DEFAULTS: &str = r#"
[data]
kind = "humanml3d"
target_frames = 196
batch_size = 64
[data.humanml3d]
root = "relative"
[optim]
learning_rate = 3e-4
weight_decay = 0.0
warmup_steps = 100
[train]
max_steps = 50000
[sampling]
clip = "none"
[sampling.sampler]
kind = "euler"
num_inference_steps = 10
guidance_scale = 1.0
"#;

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FlowTables {
    /// The history encoder and the predictor.
    pub model: ModelTable<FlowNetwork>,
    /// The captions of the model.
    pub text: CaptionsConfig,
    /// Inputs and target of the prediction.
    pub pose: PoseConfig,
    /// The evaluation.
    pub evaluation: RolloutEvaluationConfig,
}

/// The kind of networks and their sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum FlowNetwork {
    /// A recurrent history encoder and a transformer over joints.
    Flow(FlowConfig),
}

impl FlowNetwork {
    /// Its sizes.
    pub fn sizes(&self) -> &FlowConfig {
        let Self::Flow(sizes) = self;
        sizes
    }
}

impl Default for FlowNetwork {
    fn default() -> Self {
        Self::Flow(FlowConfig::default())
    }
}

/// The table `pose`: inputs and target of the prediction (docs/sources.md, section 5).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Rows of features in a history; a motion continues from one frame more.
    pub history_frames: usize,
    /// The form of the target: `position` or `displacement`, in the present frame's facing frame.
    pub target: NextPose,
    /// The prediction type.
    pub prediction_type: FlowPrediction,
    /// Probability of dropping a training sample's text, for classifier-free guidance.
    pub cond_drop_prob: f64,
    /// Standard deviation of the noise on training histories, metres, of the whole body and of each
    /// joint. The next pose corrects a tenth of it. A network trained on recorded histories only
    /// cannot correct its own errors.
    pub history_noise_std: f64,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            history_frames: 15,
            target: NextPose::default(),
            prediction_type: FlowPrediction::default(),
            cond_drop_prob: 0.1,
            history_noise_std: 0.0,
        }
    }
}

/// The table `evaluation`: the settings of `kinegrad eval`, which continues held-out clips, and of
/// sampling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RolloutEvaluationConfig {
    /// Number of held-out clips, evenly from all, with one rollout each.
    pub rollouts: usize,
    /// Frames of each rollout.
    pub frames: usize,
    /// Gives every frame the bones of the history's last one: forward kinematics of its rotations
    /// from inverse kinematics.
    pub constant_bones: bool,
    /// Samples every pose of a motion from the same noise, not each from new noise: less shaking.
    pub same_noise: bool,
}

impl Default for RolloutEvaluationConfig {
    fn default() -> Self {
        Self {
            rollouts: 16,
            frames: 200,
            constant_bones: true,
            same_noise: false,
        }
    }
}

impl SystemTables for FlowTables {
    const NETWORKS: &'static [NetworkKind] = &[NetworkKind::of::<FlowConfig>()];
}

/// Validates the tables of this system.
///
/// # Errors
/// For the first invalid value; the error names the key.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &FlowTables = config.own();
    let Config { data, sampling, .. } = config;
    own.model.network.sizes().validate()?;
    own.text.validate(data)?;
    must_be_of_clips(config)?;
    require(
        data.humanml3d.root == Root::Relative,
        "data.humanml3d.root",
        "\"absolute\"",
        format!("\"relative\" for recipe `{RECIPE}`, whose poses do not depend on the place"),
    )?;
    require(
        data.crop == Crop::Random,
        "data.crop",
        "\"leading\"",
        format!("\"random\" for recipe `{RECIPE}`, which samples windows anywhere in a clip"),
    )?;
    let prob = data.augment.path_warp_prob;
    require(
        prob == 0.0,
        "data.augment.path_warp_prob",
        prob,
        format!("0 for recipe `{RECIPE}`, which follows no path"),
    )?;
    let pose = &own.pose;
    in_range("pose.history_frames", pose.history_frames, 1..=1000)?;
    in_range("pose.cond_drop_prob", pose.cond_drop_prob, 0.0..=1.0)?;
    in_range("pose.history_noise_std", pose.history_noise_std, 0.0..=1.0)?;
    let shortest = pose.history_frames + 2;
    require(
        data.humanml3d.min_frames >= shortest,
        "data.humanml3d.min_frames",
        data.humanml3d.min_frames,
        format!("at least {shortest}: a history of `pose.history_frames` rows and the next frame"),
    )?;
    must_suit_flow(&sampling.sampler)?;
    require(
        sampling.clip == ClipSample::None,
        "sampling.clip",
        "a range",
        format!("\"none\" for recipe `{RECIPE}`, whose poses are not clipped"),
    )?;
    let evaluation = &own.evaluation;
    in_range("evaluation.rollouts", evaluation.rollouts, 1..=100_000)?;
    in_range(
        "evaluation.frames",
        evaluation.frames,
        RolloutReport::SHORTEST..=MAX_FRAMES,
    )?;
    Ok(())
}
