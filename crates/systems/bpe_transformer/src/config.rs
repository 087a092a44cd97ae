//! The system's own config tables and their validation.

use std::path::PathBuf;

use kinegrad_diffusion::{DiffusionConfig, SamplerKind, must_suit};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_motion::humanml::Root;
use kinegrad_settings::{Refused, in_range, require};
use kinegrad_train::Error;
use kinegrad_train::clips::captions::CaptionsConfig;
use kinegrad_train::clips::path_condition::PathTrainingConfig;
use kinegrad_train::clips::settings::{must_be_of_clips, must_have_no_style, validate_velocity};
use kinegrad_train::config::{ClipSample, Config, ModelTable, NetworkKind, PLAIN, SystemTables};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{ADAPTER, PathConfig, RECIPE};
use crate::network::{BlendedConfig, PathTokens};

/// Values of the common tables, from the published program where it defines the value.
pub(super) const DEFAULTS: &str = r#"
[data]
kind = "humanml3d"
target_frames = 196
batch_size = 64
[data.humanml3d]
root = "relative"
[diffusion]
beta_schedule = "cosine"
beta_min = 0.0
beta_max = 0.999
prediction_type = "sample"
loss_type = "mse"
cond_drop_prob = 0.1
[optim]
learning_rate = 1e-4
weight_decay = 0.0
warmup_steps = 0
lr_schedule = "constant"
[train]
max_steps = 500000
max_grad_norm = 0.0
[sampling]
clip = "none"
[sampling.sampler]
kind = "ddpm"
num_inference_steps = 1000
guidance_scale = 2.5
"#;

pub(super) const ADAPTER_DEFAULTS: &str = "
[model]
path = true
";

/// Tables of an initial run, with path conditioning by `tokens` if it lacks its own.
pub(super) fn with_paths(mut tables: Table, tokens: PathTokens) -> Table {
    if let Some(model) = tables.get_mut("model").and_then(Value::as_table_mut)
        && model.get("path") != Some(&Value::Boolean(true))
    {
        let tokens = Value::try_from(tokens).expect(PLAIN);
        model.insert("path".to_string(), Value::Boolean(true));
        model.insert("path_tokens".to_string(), tokens);
    }
    tables
}

/// True if a run trains a path-conditioned network; the initial network may lack path conditioning.
pub(super) fn is_path_conditioned(config: &Config) -> bool {
    config.own::<BpeTables>().model.network.sizes().path || config.train.recipe == ADAPTER
}

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BpeTables {
    /// The initial checkpoint.
    pub init: BpeInitConfig,
    /// The denoiser.
    pub model: ModelTable<BpeNetwork>,
    /// The captions of the model.
    pub text: CaptionsConfig,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// Absolute and relative positions.
    pub positions: PositionsConfig,
    /// Training of a path-conditioned network.
    pub paths: PathTrainingConfig,
    /// The trained part of recipe `path_adapter`.
    pub adapter: PathAdapterConfig,
    /// The loss.
    pub loss: BpeLossConfig,
    /// The evaluation.
    pub evaluation: ComposeEvaluationConfig,
}

/// The kind of network and its sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum BpeNetwork {
    /// A transformer with blended positional encodings.
    BpeTransformer(BlendedConfig),
}

impl BpeNetwork {
    /// Sizes of the network.
    pub fn sizes(&self) -> &BlendedConfig {
        let Self::BpeTransformer(sizes) = self;
        sizes
    }
}

impl Default for BpeNetwork {
    fn default() -> Self {
        Self::BpeTransformer(BlendedConfig::default())
    }
}

/// The table `positions`: positions in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PositionsConfig {
    /// Share of the training samples that are in relative mode.
    pub bpe_training_ratio: f64,
}

impl Default for PositionsConfig {
    fn default() -> Self {
        Self {
            bpe_training_ratio: 0.5,
        }
    }
}

/// The table `init`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BpeInitConfig {
    /// Initial run or checkpoint, which provides EMA weights, network, process and statistics. For
    /// `path_adapter`, the initial network may lack path conditioning.
    pub diffusion: PathBuf,
}

/// The table `adapter`: the trained part of recipe `path_adapter`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PathAdapterConfig {
    /// Number of last layers that are trained in addition to the path layers.
    pub last_layers: usize,
}

/// The table `loss`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BpeLossConfig {
    /// Weight of the squared error of differences between consecutive frames, which penalizes
    /// shaking. 0 in the published program. Small models shake if the weight is 0.
    pub velocity: f64,
}

/// The table `evaluation`: settings of sampling and of `kinegrad eval`, which composes motions from
/// the texts and lengths of held-out clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ComposeEvaluationConfig {
    /// Number of compositions.
    pub compositions: usize,
    /// Texts per composition.
    pub texts: usize,
    /// Frames of the window around a transition in which jerk is measured.
    pub transition_frames: usize,
    /// Switch k between absolute and relative positions in sampling with T timesteps: timestep t is
    /// relative if t <= T - k. -1 is always absolute, 0 always relative. The published models use
    /// 60 for HumanML3D and 125 for BABEL.
    pub bpe_denoising_step: i64,
    /// Number of held-out clips whose root trajectories serve as paths, followed according to
    /// `path`, to measure the deviation; 0 omits this measurement.
    pub num_paths: usize,
    /// The path-following method.
    pub path: PathConfig,
}

impl Default for ComposeEvaluationConfig {
    fn default() -> Self {
        Self {
            compositions: 16,
            texts: 4,
            transition_frames: 60,
            bpe_denoising_step: 60,
            num_paths: 0,
            path: PathConfig::default(),
        }
    }
}

impl SystemTables for BpeTables {
    const NETWORKS: &'static [NetworkKind] = &[NetworkKind::of::<BlendedConfig>()];
}

pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &BpeTables = config.own();
    let Config { data, sampling, .. } = config;
    let sizes = own.model.network.sizes();
    sizes.validate()?;
    own.diffusion.validate()?;
    own.diffusion.must_not_rescale_timesteps()?;
    own.text.validate(data)?;
    let adapts = config.train.recipe == ADAPTER;
    let tokens = sizes.path_tokens;
    let found = Value::try_from(tokens).expect(PLAIN).to_string();
    let allowed = "\"added\" without `model.path`";
    let fits = sizes.path || tokens == PathTokens::Added;
    require(fits, "model.path_tokens", found, allowed)?;
    let allowed = format!("true for recipe `{ADAPTER}`, which trains the layers of the path");
    require(!adapts || sizes.path, "model.path", false, allowed)?;
    let (key, layers) = ("adapter.last_layers", own.adapter.last_layers);
    in_range(key, layers, 0..=sizes.num_layers)?;
    let allowed = format!("0 for recipe `{RECIPE}`, which trains all layers");
    require(adapts || layers == 0, key, layers, allowed)?;
    must_be_of_clips(config)?;
    own.paths.validate(sizes.path)?;
    let ratio = own.positions.bpe_training_ratio;
    in_range("positions.bpe_training_ratio", ratio, 0.0..=1.0)?;
    let evaluation = &own.evaluation;
    let timesteps = own.diffusion.num_train_timesteps;
    let (step, steps) = (evaluation.bpe_denoising_step, -1..=timesteps as i64);
    in_range("evaluation.bpe_denoising_step", step, steps)
        .hint("-1 for absolute positions in all steps, 0 for relative ones")?;
    validate_velocity(own.loss.velocity, &own.diffusion)?;
    must_have_no_style(config, &own.diffusion)?;
    must_suit(&sampling.sampler, &own.diffusion)?;
    let clips = sampling.clip != ClipSample::None;
    let allowed = format!("\"none\" for recipe `{RECIPE}`, whose clean motion is not clipped");
    require(!clips, "sampling.clip", "a range", allowed)?;
    let path = &evaluation.path;
    path.validate(timesteps).within("evaluation.path")?;
    let kind = &sampling.sampler.kind;
    let guides = path.method.guides() && path.through_network;
    let allowed = "\"ddpm\" for guidance through the network";
    let fits = matches!(kind, SamplerKind::Ddpm(_)) || !guides;
    require(
        fits,
        "sampling.sampler.kind",
        format!("\"{kind}\""),
        allowed,
    )
    .hint("its gradient is scaled by the variance of the step, which only DDPM has")?;
    for (key, count, least) in [
        ("evaluation.compositions", evaluation.compositions, 1),
        ("evaluation.num_paths", evaluation.num_paths, 0),
        ("evaluation.texts", evaluation.texts, 1),
    ] {
        in_range(key, count, least..=10_000)?;
    }
    let (texts, is_relative) = (evaluation.texts, data.humanml3d.root == Root::Relative);
    let allowed = "1 with `data.humanml3d.root = \"absolute\"`";
    require(texts == 1 || is_relative, "evaluation.texts", texts, allowed).hint("every clip of training begins at the origin: an absolute root cannot continue with the next text")?;
    let (key, frames) = ("evaluation.transition_frames", evaluation.transition_frames);
    let longest = data.target_frames;
    let allowed = format!("at most {longest}, `data.target_frames`");
    require(frames <= longest, key, frames, allowed)
        .hint("real clips are measured in windows of that length as well")?;
    Ok(in_range(key, frames, 4..=MAX_FRAMES)?)
}
