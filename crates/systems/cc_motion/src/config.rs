//! The system's own config tables and their validation.

use std::ops::Bound;
use std::path::PathBuf;

use kinegrad_data::DataKind;
use kinegrad_diffusion::{DiffusionConfig, GuidanceScales, RolloutMode as Graph, must_suit};
use kinegrad_models::LoraConfig;
use kinegrad_motion::{PostProcessConfig, SanityThresholds};
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use kinegrad_train::Error;
use kinegrad_train::config::{ClipSample, Config, ModelTable, NetworkKind, PLAIN, SystemTables};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Table;

use super::PhrasePathConfig;
use super::losses::{SignMatching, TemporalLossConfig};
use super::recipe_name::RecipeName;
use crate::network::{DecoderConfig, StyleConditioning, UNet1dConfig};

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CcMotionConfig {
    /// The initial checkpoints of fine-tuning.
    pub init: InitConfig,
    /// The denoiser.
    pub model: ModelTable<CcMotionNetwork>,
    /// The motion decoder, in recipes `decoder` and `e2e`.
    pub decoder: DecoderConfig,
    /// Low-rank adapters on the denoiser, in recipe `e2e`. Without this table, all weights of the
    /// denoiser are fine-tuned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lora: Option<LoraConfig>,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// The differentiable sampler, in recipes `decoder` and `e2e`.
    pub rollout: RolloutConfig,
    /// The losses on decoded motion, in recipes `decoder` and `e2e`.
    pub loss: LossConfig,
    /// The evaluation.
    pub evaluation: EvaluationConfig,
}

impl SystemTables for CcMotionConfig {
    const NETWORKS: &'static [NetworkKind] = &[NetworkKind::of::<UNet1dConfig>()];
}

/// The denoiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum CcMotionNetwork {
    /// The audio-conditioned UNet.
    Unet1d(UNet1dConfig),
}

impl Default for CcMotionNetwork {
    fn default() -> Self {
        Self::Unet1d(UNet1dConfig::default())
    }
}

/// The table `init`: the initial checkpoints of fine-tuning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InitConfig {
    /// Run or checkpoint of the diffusion model, which provides EMA weights, network, process and
    /// statistics. If empty in recipe `e2e`, a base model is trained first.
    pub diffusion: PathBuf,
    /// Run or checkpoint with a decoder for the base model; if empty, a new decoder is initialized.
    pub decoder: PathBuf,
    /// Training of missing initial checkpoints.
    pub pretrain: PretrainConfig,
}

/// The table `init.pretrain`: training of a base model and a decoder in recipe `e2e` if
/// `init.diffusion` is empty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PretrainConfig {
    /// Steps of recipe `diffusion`.
    pub diffusion_steps: u64,
    /// Their learning rate.
    pub diffusion_learning_rate: f64,
    /// Steps of recipe `decoder`; 0 leaves the decoder untrained.
    pub decoder_steps: u64,
    /// Their learning rate.
    pub decoder_learning_rate: f64,
}

impl Default for PretrainConfig {
    fn default() -> Self {
        Self {
            diffusion_steps: 1000,
            diffusion_learning_rate: 1e-3,
            decoder_steps: 200,
            decoder_learning_rate: 5e-4,
        }
    }
}

/// The memory mode of a rollout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RolloutMode {
    /// One graph over all steps; memory grows with the number of steps.
    Full,
    /// Stores only the states; the backward pass recomputes each step. Same gradients as `full`.
    #[default]
    Checkpointed,
    /// A graph over the last `rollout.last_k` steps: a truncated gradient.
    LastK,
}

/// The start of a rollout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RolloutStart {
    /// The batch's motion, noised to the start timestep. Except at the last timesteps, the start
    /// contains signal of the ground truth, so a reconstruction loss is meaningful.
    #[default]
    Motion,
    /// Pure noise at the last timestep (CC-MotionGen): a reconstruction loss then pulls samples
    /// towards the mean motion.
    Noise,
}

/// The table `rollout`: the differentiable sampler.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RolloutConfig {
    /// DDIM steps K.
    pub steps: usize,
    /// The memory mode of the backward pass.
    pub mode: RolloutMode,
    /// Steps with a graph in mode `last_k`.
    pub last_k: usize,
    /// The start of a rollout.
    pub start: RolloutStart,
    /// Range of the start timesteps for `start = "motion"`, sampled uniformly. Larger values mean
    /// the last timestep.
    pub start_timesteps: [usize; 2],
    /// Clamping of the predicted clean motion.
    pub clip: ClipSample,
    /// The bound of `clip = "symmetric"`, in standard deviations; only with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_range: Option<f64>,
    /// Use a straight-through gradient for clamping.
    pub straight_through: bool,
    /// Factor of the gradient passed from each step to the previous one.
    pub gradient_decay: f64,
    /// Classifier-free guidance scale; 1 disables guidance.
    pub guidance_scale: f64,
    /// Guidance scale of the style, for models with a style condition. Omitted: `guidance_scale`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style_guidance_scale: Option<f64>,
}

impl Default for RolloutConfig {
    fn default() -> Self {
        Self {
            steps: 5,
            mode: RolloutMode::Checkpointed,
            last_k: 1,
            start: RolloutStart::Motion,
            start_timesteps: [200, 999],
            clip: ClipSample::TrainingRange,
            clip_range: None,
            straight_through: true,
            gradient_decay: 1.0,
            guidance_scale: 1.0,
            style_guidance_scale: None,
        }
    }
}

impl RolloutConfig {
    /// The guidance scales of the conditions.
    pub fn guidance(&self) -> GuidanceScales {
        GuidanceScales::new(self.guidance_scale, self.style_guidance_scale)
    }

    /// The mode with its number of steps.
    pub fn graph(&self) -> Graph {
        match self.mode {
            RolloutMode::Full => Graph::Full,
            RolloutMode::Checkpointed => Graph::Checkpointed,
            RolloutMode::LastK => Graph::LastK(self.last_k),
        }
    }

    /// Number of denoiser passes with stored activations, including the pass of the diffusion loss.
    pub(super) fn stored_passes(&self) -> u64 {
        let steps = match self.mode {
            RolloutMode::Full => self.steps,
            RolloutMode::Checkpointed => 1,
            RolloutMode::LastK => self.last_k,
        };
        1 + self.guidance().calls() * steps as u64
    }
}

/// Weighting of the reconstruction loss of each sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReconstructionWeighting {
    /// By `alphas_cumprod` at the start timestep, the share of signal in the start state.
    #[default]
    Signal,
    /// Uniform (CC-MotionGen).
    Uniform,
}

/// The table `loss` (CC-MotionGen, sections 7.1 and 7.4; docs/sources.md, section 1.8).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Weight of the diffusion loss, on normalized motion.
    pub w_diff: f64,
    /// Weight of the reconstruction, in physical units.
    pub w_dec: f64,
    /// Weight of the temporal terms, in physical units.
    pub w_temp: f64,
    /// Weight of the reconstruction of all components, in units of their standard deviations.
    /// CC-MotionGen lacks this term; without it, a constant phase and a constant orientation
    /// minimize the temporal terms.
    pub w_components: f64,
    /// Weighting of the reconstruction loss of each sample.
    pub reconstruction_weighting: ReconstructionWeighting,
    /// The treatment of q and -q in the quaternion reconstruction. The reconstruction of all
    /// components always uses the nearer sign.
    pub quaternion_sign: SignMatching,
    /// The temporal terms.
    pub temporal: TemporalLossConfig,
}

impl LossConfig {
    /// CC-MotionGen's loss, literally.
    pub fn ccmotion() -> Self {
        Self {
            w_components: 0.0,
            reconstruction_weighting: ReconstructionWeighting::Uniform,
            quaternion_sign: SignMatching::Ccmotion,
            temporal: TemporalLossConfig::ccmotion(),
            ..Self::default()
        }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            w_diff: 0.1,
            w_dec: 1.0,
            w_temp: 10.0,
            w_components: 1.0,
            reconstruction_weighting: ReconstructionWeighting::default(),
            quaternion_sign: SignMatching::default(),
            temporal: TemporalLossConfig::default(),
        }
    }
}

/// The audio condition of the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CondSource {
    /// The audio features of the held-out phrases.
    #[default]
    Phrases,
    /// Standard normal noise instead of audio features, different for each phrase: a condition
    /// without information.
    Noise,
}

/// The table `evaluation`: the settings of `kinegrad eval`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Samples per held-out phrase; at least two are needed for same-phrase diversity.
    pub seeds: usize,
    /// Number of held-out phrases to use. Omitted: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phrases: Option<usize>,
    /// The audio condition.
    pub cond: CondSource,
    /// Further guidance scales for `kinegrad eval --audio-ablation`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub guidance_scales: Vec<f64>,
    /// Beats in a bar of the held-out phrases, for `kinegrad eval --audio-ablation`. Omitted: from
    /// the dataset's manifest or beat features, else 4.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beats_per_bar: Option<usize>,
    /// The path-following method of phrases.
    pub path: PhrasePathConfig,
    /// The post-processing of samples, unless `kinegrad sample --postprocess` names a profile.
    pub postprocess: PostProcessConfig,
    /// The bounds of the profile `ccmotion`.
    pub thresholds: SanityThresholds,
}

impl Default for EvaluationConfig {
    fn default() -> Self {
        Self {
            seeds: 2,
            phrases: None,
            cond: CondSource::default(),
            guidance_scales: Vec::new(),
            beats_per_bar: None,
            path: PhrasePathConfig::default(),
            postprocess: PostProcessConfig::default(),
            thresholds: SanityThresholds::default(),
        }
    }
}

/// Rejects the first invalid value of the tables of this system.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &CcMotionConfig = config.own();
    let (name, recipe) = (RecipeName::of(config), &config.train.recipe);
    own.diffusion.validate()?;
    require(
        matches!(config.data.kind, DataKind::Phrases | DataKind::Synthetic),
        "data.kind",
        "a kind of clips",
        format!("\"phrases\" or \"synthetic\" for recipe `{recipe}`"),
    )?;
    let CcMotionNetwork::Unet1d(unet) = &own.model.network;
    unet.validate()?;
    must_suit(&config.sampling.sampler, &own.diffusion)?;
    let of_style = [
        (
            "sampling.sampler.style_guidance_scale",
            config.sampling.sampler.style_guidance_scale,
        ),
        (
            "rollout.style_guidance_scale",
            own.rollout.style_guidance_scale,
        ),
        ("diffusion.style_drop_prob", own.diffusion.style_drop_prob),
    ];
    for (key, value) in of_style {
        let Some(value) = value else { continue };
        require(
            unet.style != StyleConditioning::None,
            key,
            value,
            "nothing where `model.style` is \"none\"",
        )
        .hint("leave the key out, or train with `model.style`")?;
    }
    own.evaluation
        .path
        .validate(own.diffusion.num_train_timesteps)
        .within("evaluation.path")?;
    let postprocess = own.evaluation.postprocess.validate();
    postprocess.within("evaluation.postprocess")?;
    let thresholds = own.evaluation.thresholds.validate();
    thresholds.within("evaluation.thresholds")?;
    in_range("evaluation.seeds", own.evaluation.seeds, 1..)?;
    if let Some(phrases) = own.evaluation.phrases {
        in_range("evaluation.phrases", phrases, 1..)
            .hint("leave it out for all phrases that are held out")?;
    }
    for &scale in &own.evaluation.guidance_scales {
        in_range("evaluation.guidance_scales", scale, 0.0..)?;
    }
    if let Some(beats) = own.evaluation.beats_per_bar {
        in_range("evaluation.beats_per_bar", beats, 1..=64)
            .hint("leave it out to use the number that the dataset states for each phrase")?;
    }
    if name.trains_through_sampler() {
        own.decoder.validate()?;
        own.validate_fine_tuning(name)?;
    }
    if let Some(lora) = &own.lora {
        lora.validate()?;
        let found = format!("set, for recipe `{recipe}`");
        require(name == RecipeName::E2e, "lora", found, "recipe `e2e` alone")?;
    }
    Ok(())
}

impl CcMotionConfig {
    /// Rejects bad values in `init`, `rollout` and `loss`.
    fn validate_fine_tuning(&self, recipe: RecipeName) -> Result<(), InvalidSetting> {
        let Self {
            init,
            rollout,
            loss,
            ..
        } = self;
        let pretrain = &init.pretrain;
        if init.diffusion.as_os_str().is_empty() {
            require(
                init.decoder.as_os_str().is_empty(),
                "init.decoder",
                format!("{} without `init.diffusion`", init.decoder.display()),
                "a decoder together with the base that it was trained on",
            )?;
            require(
                recipe != RecipeName::E2e || pretrain.diffusion_steps > 0,
                "init.pretrain.diffusion_steps",
                0,
                "1 or more, or an `init.diffusion`",
            )?;
        }
        let timesteps = self.diffusion.num_train_timesteps;
        let steps = rollout.steps;
        in_range("rollout.steps", steps, 1..=timesteps).hint(format!(
            "at most diffusion.num_train_timesteps ({timesteps})"
        ))?;
        in_range("rollout.last_k", rollout.last_k, 1..=steps)
            .hint(format!("at most rollout.steps ({steps})"))?;
        let [lowest, highest] = rollout.start_timesteps;
        require(
            lowest <= highest && lowest.min(timesteps - 1) + 1 >= steps,
            "rollout.start_timesteps",
            format!("[{lowest}, {highest}]"),
            format!(
                "a lower and an upper timestep, both at least rollout.steps - 1 ({})",
                steps - 1
            ),
        )?;
        rollout.clip.validate(rollout.clip_range, "rollout")?;
        in_range("rollout.guidance_scale", rollout.guidance_scale, 0.0..)?;
        let of_style = rollout.style_guidance_scale.unwrap_or(1.0);
        in_range("rollout.style_guidance_scale", of_style, 0.0..)?;
        in_range("rollout.gradient_decay", rollout.gradient_decay, 0.0..=1.0)?;
        for (key, rate) in [
            ("diffusion_learning_rate", pretrain.diffusion_learning_rate),
            ("decoder_learning_rate", pretrain.decoder_learning_rate),
        ] {
            in_range(key, rate, 0.0..).within("init.pretrain")?;
        }
        in_range("loss.w_diff", loss.w_diff, 0.0..)?;
        in_range("loss.w_dec", loss.w_dec, 0.0..)?;
        in_range("loss.w_temp", loss.w_temp, 0.0..)?;
        in_range("loss.w_components", loss.w_components, 0.0..)?;
        // Covers every weight and target.
        for (key, value) in Table::try_from(&loss.temporal).expect(PLAIN) {
            let Some(value) = value.as_float() else {
                continue;
            };
            let allowed = match key.starts_with("target_") {
                true => ABOVE_ZERO,
                false => (Bound::Included(0.0), Bound::Unbounded),
            };
            in_range(key, value, allowed).within("loss.temporal")?;
        }
        Ok(())
    }
}
