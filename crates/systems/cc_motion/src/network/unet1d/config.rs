//! The sizes and conditions of the UNet.

use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH};
use kinegrad_models::layers::GROUPS;
use kinegrad_models::{NamedSizes, NetworkConfig};
use kinegrad_motion::{ChannelEncoding, OrientationEncoding, PhaseEncoding};
use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::audio::{AudioConditioning, widths};
use super::beats::{BeatTracker, Beats};
use super::style::StyleConditioning;

/// The sizes of a [`UNet1d`](super::UNet1d). Level `i` has `model_channels * channel_mult[i]`
/// channels and the input's length divided by `2^i`, rounded up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct UNet1dConfig {
    /// Channels of level 0; a multiple of 32.
    pub model_channels: usize,
    /// Factor of each level's channels.
    pub channel_mult: Vec<usize>,
    /// Residual blocks of an encoder level.
    pub num_res_blocks: usize,
    /// Levels with attention; level 0 is the finest. Omitted: all levels except 0.
    pub attention_levels: Option<Vec<usize>>,
    /// Number of attention heads at every width, unless `num_head_channels` is set.
    pub num_heads: usize,
    /// Channels of each attention head: wider levels have more heads. Omitted: `num_heads` heads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub num_head_channels: Option<usize>,
    /// Apply the timestep as scale and shift (FiLM) instead of addition.
    pub use_scale_shift_norm: bool,
    /// Width of the time embedding.
    pub time_embed_dim: usize,
    /// Width of the projected conditioning. With `audio_conditioning = "aligned"`: largest width of
    /// the audio encoder's levels, a multiple of 32.
    pub context_dim: usize,
    /// The audio conditioning.
    pub audio_conditioning: AudioConditioning,
    /// The source of the beats, with `audio_conditioning = "aligned"`.
    #[serde(skip_serializing_if = "Beats::are_given")]
    pub beats: Beats,
    /// Dropout inside the residual blocks.
    pub dropout: f64,
    /// The predicted encoding of the phase.
    pub phase_target: PhaseEncoding,
    /// The predicted encoding of the orientation. `data.augment.flip_quaternion` requires
    /// `quaternion`: in other encodings, q and -q are the same.
    pub orientation_target: OrientationEncoding,
    /// The style condition, in addition to the audio.
    pub style: StyleConditioning,
    /// The labels for `style = "label"` and `"both"`. If empty, the labels of the training phrases;
    /// the run's saved config and checkpoints contain these labels.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub style_labels: Vec<String>,
}

impl Default for UNet1dConfig {
    fn default() -> Self {
        Self::small()
    }
}

impl NetworkConfig for UNet1dConfig {
    const KIND: &'static str = "unet1d";

    const SIZES: NamedSizes<Self> = &[
        ("small", Self::small),
        ("tiny", Self::tiny),
        ("base", Self::base),
        ("cc116m", Self::cc116m),
    ];

    fn complete(&mut self) {
        self.attention_levels = Some(self.attention_levels());
    }
}

/// Named sizes. Parameter counts are for 25 motion and 163 audio channels.
impl UNet1dConfig {
    /// For tests and first steps.
    pub fn tiny() -> Self {
        Self {
            model_channels: 32,
            channel_mult: vec![1, 1, 2, 2],
            time_embed_dim: 64,
            context_dim: 64,
            ..Self::small()
        }
    }

    /// 16,342,361 parameters, the size of the reference run.
    pub fn small() -> Self {
        Self {
            model_channels: 64,
            channel_mult: vec![1, 2, 4, 8],
            num_res_blocks: 2,
            attention_levels: None,
            num_heads: 8,
            num_head_channels: None,
            use_scale_shift_norm: true,
            time_embed_dim: 256,
            context_dim: 256,
            audio_conditioning: AudioConditioning::Ccmotion,
            beats: Beats::Given,
            dropout: 0.1,
            phase_target: PhaseEncoding::Scalar,
            orientation_target: OrientationEncoding::Quaternion,
            style: StyleConditioning::None,
            style_labels: Vec::new(),
        }
    }

    /// 225,084,185 parameters, CC-MotionGen's literal defaults.
    pub fn base() -> Self {
        Self {
            model_channels: 256,
            ..Self::small()
        }
    }

    /// 104,436,505 parameters, the nearest consistent interpretation of CC-MotionGen's claim of 116
    /// M (docs/sources.md, section 1.15).
    pub fn cc116m() -> Self {
        Self {
            channel_mult: vec![1, 2, 4, 4],
            ..Self::base()
        }
    }
}

impl UNet1dConfig {
    /// The channels that are predicted.
    pub fn targets(&self) -> ChannelEncoding {
        ChannelEncoding {
            phase: self.phase_target,
            orientation: self.orientation_target,
        }
    }

    /// Channels of each level.
    pub fn channels(&self) -> Vec<usize> {
        let mults = self.channel_mult.iter();
        mults.map(|mult| self.model_channels * mult).collect()
    }

    /// Attention heads of a width.
    pub fn heads(&self, width: usize) -> usize {
        self.num_head_channels
            .map_or(self.num_heads, |channels| width / channels.max(1))
    }

    /// Levels with attention.
    pub fn attention_levels(&self) -> Vec<usize> {
        let all = || (1..self.channel_mult.len()).collect();
        self.attention_levels.clone().unwrap_or_else(all)
    }

    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let mults = &self.channel_mult;
        require(
            (1..=16).contains(&mults.len()) && mults.iter().all(|m| (1..=MAX_WIDTH).contains(m)),
            "model.channel_mult",
            format!("{mults:?}"),
            format!("1 to 16 factors of 1 to {MAX_WIDTH}, one a level"),
        )
        .hint("try [1, 2, 4, 8]")?;
        in_range("model.num_res_blocks", self.num_res_blocks, 1..=MAX_LAYERS)
            .hint("CC-MotionGen has 2")?;
        in_range("model.model_channels", self.model_channels, 1..=MAX_WIDTH)
            .hint("CC-MotionGen has 256")?;
        let channels = self.channels();
        for &width in &channels {
            require(
                width <= MAX_WIDTH && width.is_multiple_of(GROUPS),
                "model.model_channels",
                format!("{} (a level of {width} channels)", self.model_channels),
                format!(
                    "levels of at most {MAX_WIDTH} channels that divide into {GROUPS} groups for \
                     GroupNorm"
                ),
            )
            .hint(format!(
                "choose `model.model_channels` a multiple of {GROUPS}"
            ))?;
        }
        let (coarsest, attending) = (channels.len() - 1, self.attention_levels());
        require(
            attending.iter().all(|&level| level <= coarsest),
            "model.attention_levels",
            format!("{attending:?}"),
            format!("levels 0 to {coarsest}"),
        )
        .hint("one entry a level that attends")?;
        // In the decoder, attention of a level has the width of the next finer level.
        let above = |&level: &usize| (level != coarsest).then(|| level.saturating_sub(1));
        let ups: Vec<usize> = attending.iter().filter_map(above).collect();
        let aligned = self.audio_conditioning == AudioConditioning::Aligned;
        for level in attending.into_iter().chain([coarsest]).chain(ups) {
            let width = channels[level];
            let (key, given, hint) = match self.num_head_channels {
                Some(channels) => (
                    "model.num_head_channels",
                    channels,
                    "CC-MotionGen names 64; leave the key out for `model.num_heads` heads",
                ),
                None => ("model.num_heads", self.num_heads, "CC-MotionGen has 8"),
            };
            let heads = |fit: bool, allowed: String| require(fit, key, given, allowed).hint(hint);
            heads(
                given > 0 && width.is_multiple_of(given),
                format!("a divisor of level {level}'s {width} channels"),
            )?;
            heads(
                !aligned || (width / self.heads(width)).is_multiple_of(2),
                format!(
                    "heads of an even number of level {level}'s {width} channels, which \
                     `model.audio_conditioning = \"aligned\"` turns in pairs"
                ),
            )?;
        }
        require(
            !aligned || self.context_dim.is_multiple_of(GROUPS),
            "model.context_dim",
            self.context_dim,
            format!("a multiple of {GROUPS} where `model.audio_conditioning = \"aligned\"`"),
        )
        .hint("64 to 256 is usual")?;
        require(
            (2..=MAX_WIDTH).contains(&self.time_embed_dim) && self.time_embed_dim.is_multiple_of(2),
            "model.time_embed_dim",
            self.time_embed_dim,
            format!("an even number, 2 to {MAX_WIDTH}"),
        )
        .hint("half are cosines, half sines")?;
        in_range("model.context_dim", self.context_dim, 1..=MAX_WIDTH)
            .hint("CC-MotionGen has 256")?;
        require(
            aligned || self.beats == Beats::Given,
            "model.beats",
            "\"tracked\" with `model.audio_conditioning = \"ccmotion\"`",
            "\"given\", or `model.audio_conditioning = \"aligned\"`",
        )
        .hint("a network that attends to a set of frames has no use for their times")?;
        in_range("model.dropout", self.dropout, 0.0..1.0).hint("CC-MotionGen has 0.1")?;
        self.validate_style()
    }

    fn validate_style(&self) -> Result<(), InvalidSetting> {
        let labels = &self.style_labels;
        let must = |fit: bool, allowed: String| {
            require(fit, "model.style_labels", format!("{labels:?}"), allowed)
                .hint("leave the key out: labels are those of the training phrases")
        };
        must(
            labels.is_empty() || self.style.has_label(),
            "labels where `model.style` is \"label\" or \"both\"".into(),
        )?;
        let mut places = labels.iter().enumerate();
        let differ = places
            .all(|(place, label)| !label.trim().is_empty() && !labels[..place].contains(label));
        must(
            differ && labels.len() <= MAX_WIDTH,
            format!("up to {MAX_WIDTH} labels that differ, none of them empty"),
        )
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        let attending = self.attention_levels();
        let of_level = |(level, width): (usize, usize)| {
            let here = frames.div_ceil(1 << level) as u64;
            // A block stores its input and the outputs of its convolutions and its dropout. The
            // decoder has two blocks; the first block also takes the skip connection.
            let blocks = 4 * self.num_res_blocks as u64 + 12;
            let attention = 2 * u64::from(attending.contains(&level));
            // Queries, keys, values and results, and keys and values of the context (for aligned
            // audio: of the level's frames, and rotated).
            let context = match self.audio_conditioning {
                AudioConditioning::Ccmotion => 2 * frames as u64,
                AudioConditioning::Aligned => 8 * here,
            };
            width as u64 * (blocks * here + attention * (9 * here + context))
        };
        let channels = self.channels();
        let network: u64 = channels.iter().copied().enumerate().map(of_level).sum();
        if self.audio_conditioning == AudioConditioning::Ccmotion {
            return network;
        }
        // The audio encoder stores the outputs of its convolutions and of each addition to the
        // UNet.
        let encoder = |(level, width): (usize, usize)| {
            let here = frames.div_ceil(1 << level) as u64;
            (3 * width + 2 * channels[level]) as u64 * here
        };
        let widths = widths(&channels, self.context_dim).into_iter();
        let tracker = match self.beats {
            Beats::Given => 0,
            Beats::Tracked => BeatTracker::ACTIVATIONS * frames as u64,
        };
        network + tracker + widths.enumerate().map(encoder).sum::<u64>()
    }
}
