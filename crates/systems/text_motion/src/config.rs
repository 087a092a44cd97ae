//! The system's own config tables and their validation.

use std::path::PathBuf;

use kinegrad_motion::humanml::Root;
use kinegrad_settings::{ABOVE_ZERO, in_range, require};
use kinegrad_train::Error;
use kinegrad_train::clips::settings::must_be_of_clips;
use kinegrad_train::config::{Config, ModelTable, NetworkKind, SystemTables};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::RECIPE;
use crate::network::TextMotionSizes;

pub(super) const DEFAULTS: &str = r#"
[data]
kind = "humanml3d"
target_frames = 196
batch_size = 32
[data.humanml3d]
root = "relative"
[optim]
learning_rate = 1e-4
weight_decay = 0.0
warmup_steps = 0
lr_schedule = "constant"
[train]
max_steps = 20000
[sampling]
clip = "none"
"#;

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TextMotionTables {
    /// The encoders.
    pub model: ModelTable<TextMotionNetwork>,
    /// The word vectors of captions.
    pub words: WordsConfig,
    /// The loss.
    pub loss: TextMotionLossConfig,
}

/// The kind of encoders and their sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TextMotionNetwork {
    /// Convolutions and GRUs.
    TextMotion(TextMotionSizes),
}

impl TextMotionNetwork {
    /// Sizes of the network.
    pub fn sizes(&self) -> &TextMotionSizes {
        let Self::TextMotion(sizes) = self;
        sizes
    }
}

impl Default for TextMotionNetwork {
    fn default() -> Self {
        Self::TextMotion(TextMotionSizes::default())
    }
}

/// The table `words`: the word vectors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WordsConfig {
    /// Word vectors as safetensors (docs/dataset.md). Without a file, every word has a random
    /// vector. Random vectors distinguish words without their meaning, which suffices for few
    /// captions.
    pub vectors: PathBuf,
    /// Width of a vector without a file.
    pub width: usize,
}

impl Default for WordsConfig {
    fn default() -> Self {
        Self {
            vectors: PathBuf::new(),
            width: 64,
        }
    }
}

/// The table `loss`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TextMotionLossConfig {
    /// Distance of a caption from other clips' motions beyond which the loss is zero.
    pub margin: f64,
}

impl Default for TextMotionLossConfig {
    fn default() -> Self {
        Self { margin: 10.0 }
    }
}

impl SystemTables for TextMotionTables {
    const NETWORKS: &'static [NetworkKind] = &[NetworkKind::of::<TextMotionSizes>()];
}

pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &TextMotionTables = config.own();
    let data = &config.data;
    own.model.network.sizes().validate()?;
    in_range("words.width", own.words.width, 1..=4096)?;
    in_range("loss.margin", own.loss.margin, ABOVE_ZERO)?;
    must_be_of_clips(config)?;
    let is_relative = data.humanml3d.root == Root::Relative;
    let allowed =
        format!("\"relative\" for recipe `{RECIPE}`, whose embeddings do not depend on the place");
    require(is_relative, "data.humanml3d.root", "\"absolute\"", allowed)?;
    let (key, frames) = ("data.target_frames", data.target_frames);
    require(frames >= 8, key, frames, "8 or more: two movements")?;
    let sampling = &config.sampling;
    for (key, count) in [
        ("sampling.count_at_end", sampling.count_at_end as u64),
        ("sampling.preview_every_steps", sampling.preview_every_steps),
    ] {
        let allowed = format!("0 for recipe `{RECIPE}`, which generates nothing");
        require(count == 0, key, count, allowed)?;
    }
    Ok(())
}
