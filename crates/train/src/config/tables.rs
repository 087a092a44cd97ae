//! The tables of a config that belong to training itself.

use std::collections::BTreeMap;

use kinegrad_diffusion::{ClipRange, SamplerConfig};
use kinegrad_kernels::Precision;
use kinegrad_motion::Statistics;
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Config;
use crate::recipe::RecipeInfo;

/// The table `run`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RunConfig {
    /// Name of the run's folder under the runs directory; if empty, the config file's name.
    pub name: String,
    /// Random seed.
    pub seed: u64,
    /// `auto`, `cpu`, or a device of this build (`kinegrad devices` lists them).
    pub device: String,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            name: String::new(),
            seed: 42,
            device: "auto".into(),
        }
    }
}

/// Learning rate schedule after the warm-up, over the rest of the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LrSchedule {
    /// Cosine decay to zero.
    #[default]
    Cosine,
    /// Linear decay to zero.
    Linear,
    /// Constant.
    Constant,
}

/// The parameters that weight decay applies to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeightDecayGroups {
    /// All parameters (CC-MotionGen).
    #[default]
    All,
    /// Weights of two or more dimensions (linear layers and convolutions), as is common in PyTorch.
    /// Biases, norms and adapters do not decay.
    Matrices,
}

/// The memory for the optimizer's moments and the weights' moving average.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OptimPlace {
    /// Device memory on a GPU; main memory on the CPU and with several ranks.
    #[default]
    Auto,
    /// Main memory: a GPU then stores only weights and gradients.
    Host,
    /// Device memory, beside the networks.
    Device,
}

/// The table `optim`: AdamW (CC-MotionGen, section 6.3; docs/sources.md, section 1.10).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OptimConfig {
    /// Learning rate after the warm-up.
    pub learning_rate: f64,
    /// Decoupled weight decay, scaled by the learning rate.
    pub weight_decay: f64,
    /// The parameters that decay.
    pub weight_decay_groups: WeightDecayGroups,
    /// Decay of the running means of gradient and squared gradient.
    pub betas: [f64; 2],
    /// Added to the denominator of the update.
    pub eps: f64,
    /// Steps over which the learning rate rises linearly from 0.
    pub warmup_steps: u64,
    /// Schedule after the warm-up.
    pub lr_schedule: LrSchedule,
    /// Learning rates of parameter groups (`unet`, `decoder`) that override `learning_rate`.
    pub groups: BTreeMap<String, f64>,
    /// The memory for moments and moving average; the choice changes the last bits of results.
    pub offload: OptimPlace,
    /// Shard moments and moving average over the ranks (ZeRO-1). Sharding saves memory and does not
    /// change results.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub shard_states: bool,
}

impl OptimConfig {
    /// The rate after the warm-up for the group `name`.
    pub fn rate_of(&self, name: &str) -> f64 {
        self.groups.get(name).copied().unwrap_or(self.learning_rate)
    }
}

impl Default for OptimConfig {
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            weight_decay: 1e-4,
            weight_decay_groups: WeightDecayGroups::All,
            betas: [0.9, 0.999],
            eps: 1e-8,
            warmup_steps: 1000,
            lr_schedule: LrSchedule::Cosine,
            groups: BTreeMap::new(),
            offload: OptimPlace::default(),
            shard_states: false,
        }
    }
}

/// The precision of the networks' matrix products.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProductPrecision {
    /// 32 bits.
    #[default]
    Float32,
    /// Matrix products in bfloat16, other operations in float32. Faster on GPUs with bfloat16
    /// matrix units, slower on the CPU.
    Bf16,
}

impl ProductPrecision {
    /// The precision as the kernels name it.
    pub fn of_products(self) -> Precision {
        match self {
            Self::Float32 => Precision::Float32,
            Self::Bf16 => Precision::Bfloat16,
        }
    }
}

/// The table `train`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// The training recipe, which belongs to one system.
    pub recipe: String,
    /// Total number of optimizer steps. Omitted: the recipe's default, or `epochs`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_steps: Option<u64>,
    /// Total number of epochs, instead of `max_steps`. An epoch has the training items divided by
    /// the items of a step (`data.batch_size` times `gradient_accumulation_steps`) as steps, rounded
    /// up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epochs: Option<u64>,
    /// Number of batches whose gradients are averaged for one step, weighted by valid frames. The
    /// batches together act as one large batch.
    pub gradient_accumulation_steps: u64,
    /// The precision of a step's products; weights, losses, the optimizer and validation stay in
    /// float32.
    pub precision: ProductPrecision,
    /// Gradients are clipped to this global norm; 0 disables clipping.
    pub max_grad_norm: f64,
    /// Steps between metrics.
    pub log_every_steps: u64,
    /// Early stopping: number of validations without improvement after which training ends; 0
    /// disables it.
    pub patience: u64,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            recipe: "diffusion".into(),
            max_steps: None,
            epochs: None,
            gradient_accumulation_steps: 1,
            precision: ProductPrecision::default(),
            max_grad_norm: 1.0,
            log_every_steps: 1,
            patience: 0,
        }
    }
}

/// The table `ema`: the exponential moving average of the weights, used for sampling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EmaConfig {
    /// Decay of the average; with 0, the average is a copy of the weights.
    pub decay: f64,
    /// Optimizer steps between updates.
    pub update_every: u64,
    /// With `power`, the decay of update n is at most `1 - (1 + n / inv_gamma)^-power`, so that
    /// initial weights fade early in training; 0 disables this warm-up.
    pub inv_gamma: f64,
    /// See `inv_gamma`.
    pub power: f64,
}

impl Default for EmaConfig {
    fn default() -> Self {
        // With CC-MotionGen's decay of 0.9999 every 10 steps, the average still contains 85 % of
        // the initial weights after 16400 steps, hence the warm-up.
        Self {
            decay: 0.9999,
            update_every: 10,
            inv_gamma: 9.0,
            power: 1.0,
        }
    }
}

/// The table `checkpoint`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Steps between checkpoints; training also writes a checkpoint at the end and at each best
    /// validation. Omitted: 500, or `every_epochs`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_steps: Option<u64>,
    /// Epochs between checkpoints, instead of `every_steps`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_epochs: Option<u64>,
    /// Number of latest checkpoints to keep, in addition to the best checkpoint.
    pub keep_last: usize,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self {
            every_steps: None,
            every_epochs: None,
            keep_last: 3,
        }
    }
}

/// The criterion of the best checkpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SelectBy {
    /// The validation loss, which is lowest for the mean of all plausible motions and so rewards
    /// samples that are all alike.
    #[default]
    Loss,
    /// The Fréchet distance of samples from their held-out phrases, as in `kinegrad eval`.
    Frechet,
    /// The deviation of the samples' diversity from that of the held-out phrases, as a symmetric
    /// ratio; 0 if equal. Diversity does not reveal implausible samples.
    Diversity,
}

/// The table `validation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationConfig {
    /// Steps between validations; 0 disables validation. Omitted: 500, or `every_epochs`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_steps: Option<u64>,
    /// Epochs between validations, instead of `every_steps`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_epochs: Option<u64>,
    /// Number of noise samples per held-out phrase for the diffusion loss; a rollout is sampled
    /// once.
    pub draws: usize,
    /// The criterion of the best checkpoint and of `train.patience`, for recipes on phrases.
    pub select_by: SelectBy,
    /// Number of held-out phrases with one sample each, if `select_by` is not `loss`. The distance
    /// between 18 features is unreliable with fewer than 20 phrases.
    pub select_samples: usize,
    /// Phrases per forward pass. With phrases of one length, the batch size changes the result only
    /// by rounding.
    pub batch_size: usize,
}

impl Default for ValidationConfig {
    fn default() -> Self {
        Self {
            every_steps: None,
            every_epochs: None,
            draws: 8,
            select_by: SelectBy::Loss,
            select_samples: 32,
            batch_size: 27,
        }
    }
}

/// Clipping of the predicted clean motion in each sampling step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClipSample {
    /// Clips each channel to its range in the training data. Unavailable with an emphasis
    /// projection or with statistics that came with the dataset.
    #[default]
    TrainingRange,
    /// CC-MotionGen's -1 to 1, in normalized units. Real motion reaches 21 standard deviations in
    /// single channels, so this range flattens motion.
    Unit,
    /// -6 to 6 in normalized units, as for the published trajectory model.
    Six,
    /// `-clip_range` to `clip_range` in normalized units.
    Symmetric,
    /// No clipping.
    None,
}

impl ClipSample {
    /// Rejects a `clip_range` that is missing, without use or not positive; `table` contains both.
    ///
    /// # Errors
    /// Names the key.
    pub fn validate(self, clip_range: Option<f64>, table: &str) -> Result<(), InvalidSetting> {
        let hint = "for example 2.5; the bounds are in standard deviations of normalized motion";
        let checked = match (self, clip_range) {
            (Self::Symmetric, Some(bound)) => in_range("clip_range", bound, 1e-6..=1e6),
            (Self::Symmetric, None) => require(
                false,
                "clip_range",
                "not set",
                "a number with `clip = \"symmetric\"`",
            ),
            (_, Some(bound)) => require(
                false,
                "clip_range",
                bound,
                "set only with `clip = \"symmetric\"`",
            ),
            (_, None) => Ok(()),
        };
        checked.within(table).hint(hint)
    }

    /// The bounds of the first `channels`, in normalized units; `clip_range` is the bound of
    /// [`Symmetric`](Self::Symmetric).
    ///
    /// # Errors
    /// If the range of the training motion is needed but not known.
    pub fn range(
        self,
        clip_range: Option<f64>,
        statistics: &Statistics,
        channels: usize,
    ) -> Result<ClipRange, InvalidSetting> {
        Ok(match self {
            Self::TrainingRange => {
                let unknown = || {
                    let allowed = "\"six\", \"unit\" or \"none\": the checkpoint does not contain the \
                                   range of the training motion";
                    InvalidSetting::new("sampling.clip", "\"training_range\"", allowed)
                        .hint("its statistics came with the dataset, or an older version wrote it")
                };
                let [mut min, mut max] = statistics.normalized_range().ok_or_else(unknown)?;
                min.truncate(channels);
                max.truncate(channels);
                ClipRange::PerChannel { min, max }
            }
            Self::Unit => ClipRange::Symmetric(1.0),
            Self::Six => ClipRange::Symmetric(6.0),
            Self::Symmetric => ClipRange::Symmetric(clip_range.unwrap_or(1.0) as f32),
            Self::None => ClipRange::None,
        })
    }
}

/// The table `sampling`: sampler settings of the run, for samples at the run's end and
/// `kinegrad sample`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingConfig {
    /// Number of samples generated when training ends; phrases are post-processed and checked.
    pub count_at_end: usize,
    /// Steps between previews; 0 disables previews. A preview has `count_at_end` samples (4 if
    /// `count_at_end` is 0) of the EMA weights for the first held-out items, as a page in the run's
    /// folder and as TensorBoard images. Each preview also writes a checkpoint.
    pub preview_every_steps: u64,
    /// The clipping range of the predicted clean motion.
    pub clip: ClipSample,
    /// The bound of `clip = "symmetric"`, in standard deviations; only with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_range: Option<f64>,
    /// The precision of the sampled networks' products; the sampler, post-processing, measures and
    /// evaluators stay in float32.
    pub precision: ProductPrecision,
    /// The sampler.
    pub sampler: SamplerConfig,
}

impl SamplingConfig {
    /// The bounds of the predicted clean motion, in normalized units.
    ///
    /// # Errors
    /// As [`ClipSample::range`].
    pub fn clip_bounds(
        &self,
        statistics: &Statistics,
        channels: usize,
    ) -> Result<ClipRange, InvalidSetting> {
        self.clip.range(self.clip_range, statistics, channels)
    }
}

/// Rejects invalid values in the tables of training.
pub(crate) fn validate(config: &Config, recipe: &RecipeInfo) -> Result<(), InvalidSetting> {
    let Config {
        optim,
        train,
        ema,
        checkpoint,
        validation,
        sampling,
        ..
    } = config;
    let accumulation = train.gradient_accumulation_steps;
    in_range(
        "train.gradient_accumulation_steps",
        accumulation,
        1..=65_536,
    )?;
    sampling.clip.validate(sampling.clip_range, "sampling")?;
    for (key, count) in [
        ("train.max_steps", train.max_steps),
        ("train.epochs", train.epochs),
        ("checkpoint.every_steps", checkpoint.every_steps),
        ("checkpoint.every_epochs", checkpoint.every_epochs),
        ("validation.every_epochs", validation.every_epochs),
    ] {
        in_range(key, count.unwrap_or(1), 1..)?;
    }
    in_range("train.log_every_steps", train.log_every_steps, 1..)?;
    in_range("train.max_grad_norm", train.max_grad_norm, 0.0..)?;
    in_range("checkpoint.keep_last", checkpoint.keep_last, 1..)?;
    in_range("validation.draws", validation.draws, 1..=1_000)?;
    let samples = validation.select_samples;
    in_range("validation.select_samples", samples, 2..=65_536)?;
    in_range("validation.batch_size", validation.batch_size, 1..=65_536)?;
    in_range("ema.update_every", ema.update_every, 1..)?;
    in_range("ema.decay", ema.decay, 0.0..=1.0)?;
    in_range("ema.inv_gamma", ema.inv_gamma, 0.0..)?;
    in_range("ema.power", ema.power, ABOVE_ZERO)?;
    in_range("optim.learning_rate", optim.learning_rate, 0.0..)?;
    in_range("optim.weight_decay", optim.weight_decay, 0.0..)?;
    in_range("optim.eps", optim.eps, ABOVE_ZERO)?;
    for beta in optim.betas {
        in_range("optim.betas", beta, 0.0..1.0)?;
    }
    for (name, &rate) in &optim.groups {
        let key = format!("optim.groups.{name}");
        let allowed = format!("groups of this recipe: {}", recipe.groups.join(", "));
        require(recipe.groups.contains(&name.as_str()), &key, rate, allowed)?;
        in_range(key, rate, 0.0..)?;
    }
    let shares = optim.offload == OptimPlace::Device && optim.shard_states;
    require(
        !shares,
        "optim.shard_states",
        "true",
        "false, as `optim.offload` is \"device\": ranks share states in main memory",
    )?;
    let name = &config.run.name;
    let is_separator = |c: char| c.is_control() || matches!(c, '/' | '\\');
    let plain = !name.contains(is_separator) && !name.starts_with('.');
    require(
        plain,
        "run.name",
        format!("\"{name}\""),
        "a plain folder name without control characters",
    )
}
