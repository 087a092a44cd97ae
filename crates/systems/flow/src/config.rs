//! The system's own config tables and their validation.

use kinegrad_data::Crop;
use kinegrad_diffusion::{FlowPrediction, must_suit_flow};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_motion::humanml::{NextPose, Root};
use kinegrad_settings::{in_range, require};
use kinegrad_train::Error;
use kinegrad_train::clips::captions::CaptionsConfig;
use kinegrad_train::clips::settings::must_be_of_clips;
use kinegrad_train::config::{ClipSample, Config, ModelTable, NetworkKind, SystemTables};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{RECIPE, RolloutReport};
use crate::network::FlowConfig;

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
    /// Sizes of the networks.
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
    /// Rows of features in a history; a motion continues from one more frame.
    pub history_frames: usize,
    /// The form of the target: `position` or `displacement`, in the present frame's facing frame.
    pub target: NextPose,
    /// The prediction type.
    pub prediction_type: FlowPrediction,
    /// Probability of dropping a training sample's text, for classifier-free guidance.
    pub cond_drop_prob: f64,
    /// Standard deviation of the noise on training histories, in meters, for the whole body and for
    /// each joint. The next pose corrects a tenth of the noise. A network trained only on recorded
    /// histories cannot correct its own errors.
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

/// The table `evaluation`: settings of sampling and of `kinegrad eval`, which continues held-out
/// clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RolloutEvaluationConfig {
    /// Number of held-out clips, evenly selected, with one rollout each.
    pub rollouts: usize,
    /// Frames of each rollout.
    pub frames: usize,
    /// Gives every frame the bone lengths of the history's last frame: rotations from inverse
    /// kinematics, then forward kinematics.
    pub constant_bones: bool,
    /// Samples all poses of a motion from the same noise instead of new noise per pose, which
    /// reduces shaking.
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

pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &FlowTables = config.own();
    let Config { data, sampling, .. } = config;
    own.model.network.sizes().validate()?;
    own.text.validate(data)?;
    must_be_of_clips(config)?;
    let is_relative = data.humanml3d.root == Root::Relative;
    let allowed =
        format!("\"relative\" for recipe `{RECIPE}`, whose poses do not depend on the place");
    require(is_relative, "data.humanml3d.root", "\"absolute\"", allowed)?;
    let allowed =
        format!("\"random\" for recipe `{RECIPE}`, which samples windows anywhere in a clip");
    require(
        data.crop == Crop::Random,
        "data.crop",
        "\"leading\"",
        allowed,
    )?;
    let (key, prob) = ("data.augment.path_warp_prob", data.augment.path_warp_prob);
    let allowed = format!("0 for recipe `{RECIPE}`, which follows no path");
    require(prob == 0.0, key, prob, allowed)?;
    let pose = &own.pose;
    in_range("pose.history_frames", pose.history_frames, 1..=1000)?;
    in_range("pose.cond_drop_prob", pose.cond_drop_prob, 0.0..=1.0)?;
    in_range("pose.history_noise_std", pose.history_noise_std, 0.0..=1.0)?;
    let (frames, shortest) = (data.humanml3d.min_frames, pose.history_frames + 2);
    let allowed =
        format!("at least {shortest}: a history of `pose.history_frames` rows and the next frame");
    require(
        frames >= shortest,
        "data.humanml3d.min_frames",
        frames,
        allowed,
    )?;
    must_suit_flow(&sampling.sampler)?;
    let clips = sampling.clip != ClipSample::None;
    let allowed = format!("\"none\" for recipe `{RECIPE}`, whose poses are not clipped");
    require(!clips, "sampling.clip", "a range", allowed)?;
    let evaluation = &own.evaluation;
    in_range("evaluation.rollouts", evaluation.rollouts, 1..=100_000)?;
    let lengths = RolloutReport::SHORTEST..=MAX_FRAMES;
    Ok(in_range("evaluation.frames", evaluation.frames, lengths)?)
}
