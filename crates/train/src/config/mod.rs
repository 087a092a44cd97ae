//! The config of a run: plain data with a schema.
//!
//! Every key has a default, and the defaults are CC-MotionGen's values where those are sound.
//! [`load()`] reads a file with overrides, [`Config::validate`] refuses what cannot work before any
//! work starts, and the resolved config is saved beside the run.

mod clips;
mod defaults;
mod difference;
mod end_to_end;
mod error;
mod load;
mod steering;
mod tables;

pub use difference::{Difference, difference};
pub use end_to_end::{
    InitConfig, LossConfig, PretrainConfig, ReconstructionWeighting, RolloutConfig, RolloutMode,
    RolloutStart,
};
pub use error::ConfigError;
pub use load::{load, load_over, parse, to_toml};
pub use steering::SteeringConfig;
pub use tables::{
    CheckpointConfig, Clip, EmaConfig, LrSchedule, OptimConfig, Recipe, RunConfig, SamplingConfig,
    TrainConfig, ValidationConfig,
};

use kinegrad_data::DataConfig;
use kinegrad_diffusion::DiffusionConfig;
use kinegrad_models::{DecoderConfig, LoraConfig, ModelConfig};
use kinegrad_motion::emphasis::EmphasisConfig;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Everything a run is made from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Name, seed, device.
    pub run: RunConfig,
    /// Where the phrases come from and how batches are made of them.
    pub data: DataConfig,
    /// What a fine-tuning starts from.
    pub init: InitConfig,
    /// The denoiser.
    pub model: ModelConfig,
    /// The motion decoder, in recipes that have one.
    pub decoder: DecoderConfig,
    /// Low-rank adapters on the denoiser, in recipe `e2e`; without this table all its weights are
    /// fine-tuned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lora: Option<LoraConfig>,
    /// The space that a motion model of recipe `gmd_motion` works in.
    pub emphasis: EmphasisConfig,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// The sampler that gradients pass through, in recipes that have one.
    pub rollout: RolloutConfig,
    /// The losses on decoded motion, in recipes that have one.
    pub loss: LossConfig,
    /// AdamW and its learning rate.
    pub optim: OptimConfig,
    /// Which training, how long.
    pub train: TrainConfig,
    /// The moving average of the weights.
    pub ema: EmaConfig,
    /// When to save and what to keep.
    pub checkpoint: CheckpointConfig,
    /// When and how to measure on held-out phrases.
    pub validation: ValidationConfig,
    /// How to draw samples from the trained model.
    pub sampling: SamplingConfig,
}

impl Config {
    /// The config with every key that a named size implies written out.
    #[must_use]
    pub fn resolved(&self) -> Self {
        Self {
            model: self.model.resolved(),
            ..self.clone()
        }
    }

    /// Refuses values that cannot work and returns what is doubtful.
    ///
    /// # Errors
    /// Names the first key with a bad value, what it is, what is allowed and how to mend it.
    pub fn validate(&self) -> Result<Vec<String>, Error> {
        self.data.validate()?;
        self.diffusion.validate()?;
        if self.train.recipe.reads_clips() {
            clips::validate(self)?;
        } else {
            clips::refuse_clips(self)?;
            self.model.unet1d(
                kinegrad_motion::phrase::CHANNELS,
                kinegrad_data::AUDIO_CHANNELS,
            )?;
        }
        self.sampling
            .sampler
            .validate(self.diffusion.num_train_timesteps)?;
        tables::validate(self)?;
        if self.train.recipe.rolls_out() {
            self.decoder.validate()?;
            end_to_end::validate(self)?;
        }
        if let Some(lora) = &self.lora {
            lora.validate()?;
            if self.train.recipe != Recipe::E2e {
                let found = format!("set, for recipe `{}`", self.train.recipe.name());
                return Err(ConfigError::range("lora", found, "recipe `e2e` alone").into());
            }
        }
        let mut warnings = Vec::new();
        if self.optim.warmup_steps > self.train.max_steps {
            warnings.push(format!(
                "`optim.warmup_steps` ({}) is longer than `train.max_steps` ({}): the learning \
                 rate never reaches `optim.learning_rate`",
                self.optim.warmup_steps, self.train.max_steps
            ));
        }
        warnings.extend(clips::warnings(self));
        Ok(warnings)
    }
}
