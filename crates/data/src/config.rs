//! The `data` table of a training config.

mod clips;

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::audio_layout::{AudioGroup, AudioLayout, check_groups};
use crate::labels::check_patterns;
use crate::location::Location;
use crate::prefetch::LOOK_AHEAD_PER_WORKER;
use crate::{Error, Humanml3dConfig};

/// Minimum frames of a sample: the third difference of the jerk check needs four.
pub const MIN_FRAMES: usize = 4;

/// The allowed frames per sample.
const FRAMES: RangeInclusive<usize> = MIN_FRAMES..=crate::MAX_FRAMES;

/// The dataset and its loading. Settings of phrases also apply to [clips](crate::humanml), unless
/// stated otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Kind of the dataset.
    pub kind: DataKind,
    /// Location of the dataset: a folder, or a `file://`, `gs://`, `s3://`, `http://` or `https://`
    /// URI. Required for `kind = "phrases"` and `kind = "humanml3d"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Groups of audio features: `["ccmotion"]` (the 163 features of CC-MotionGen) or `["ccmotion",
    /// "beats"]`, which needs a dataset with beat features.
    pub audio_features: Vec<AudioGroup>,
    /// Frames per sample, at 30 frames per second (HumanML3D: 20, usually 196 frames). Longer
    /// phrases are cropped, shorter phrases are padded.
    pub target_frames: usize,
    /// Cropping of longer phrases.
    pub crop: Crop,
    /// Data for the normalization statistics of phrases. Fine-tuning keeps the statistics of the
    /// initial model.
    pub statistics: StatisticsOf,
    /// Joins consecutive training phrases of one recording (ids `NAME_FIRSTFRAME`), so that random
    /// crops may begin up to half a phrase earlier or later.
    pub join_neighbours: bool,
    /// Samples in a batch.
    pub batch_size: usize,
    /// Threads that prefetch batches; 0 prepares each batch on demand, on all cores.
    pub num_workers: usize,
    /// Handling of unusable phrases.
    pub on_bad_phrase: OnBadPhrase,
    /// Use only the first ids, in sorted order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub num_phrases: Option<usize>,
    /// Labels of phrases, such as the dance style, for networks with `model.style`. A key is an id
    /// or a pattern with `*`; the longest match wins and overrides the manifest. An empty label
    /// removes the label.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// Held-out phrases.
    pub validation: ValidationSplit,
    /// Data augmentation.
    pub augment: AugmentConfig,
    /// Caches.
    pub cache: CacheConfig,
    /// Access to buckets and web servers.
    pub store: StoreConfig,
    /// The phrases of `kind = "synthetic"` and walks of `kind = "synthetic_walks"`.
    pub synthetic: SyntheticConfig,
    /// Reading of the clips of `kind = "humanml3d"` and `kind = "synthetic_walks"`.
    pub humanml3d: Humanml3dConfig,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            kind: DataKind::Phrases,
            source: None,
            audio_features: AudioLayout::CCMOTION.groups(),
            target_frames: 120,
            crop: Crop::Random,
            statistics: StatisticsOf::Phrases,
            join_neighbours: false,
            batch_size: 32,
            num_workers: 4,
            on_bad_phrase: OnBadPhrase::Error,
            num_phrases: None,
            labels: BTreeMap::new(),
            validation: ValidationSplit::default(),
            augment: AugmentConfig::default(),
            cache: CacheConfig::default(),
            store: StoreConfig::default(),
            synthetic: SyntheticConfig::default(),
            humanml3d: Humanml3dConfig::default(),
        }
    }
}

/// Kind of dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DataKind {
    /// The phrase layout of CC-MotionGen, section 1.3, read from `source`.
    Phrases,
    /// [Synthetic phrases](crate::synthetic), no files needed.
    Synthetic,
    /// [Clips](crate::humanml) in the layout of HumanML3D, read from `source`.
    Humanml3d,
    /// [Synthetic walks](crate::humanml::walk), clips without files.
    SyntheticWalks,
}

impl DataKind {
    /// True for datasets of clips, false for datasets of phrases.
    pub fn is_clips(self) -> bool {
        matches!(self, Self::Humanml3d | Self::SyntheticWalks)
    }

    /// True for datasets that are read from `source`.
    pub fn has_source(self) -> bool {
        matches!(self, Self::Phrases | Self::Humanml3d)
    }
}

impl fmt::Display for DataKind {
    /// Its name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Cropping of longer phrases to `target_frames`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Crop {
    /// A new random window each time.
    Random,
    /// The first frames (CC-MotionGen, section 6.1).
    Leading,
}

/// Data for the normalization statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StatisticsOf {
    /// Whole training phrases, as stored.
    #[default]
    Phrases,
    /// Augmented training crops, the same for every seed.
    Crops,
}

/// Handling of a phrase that cannot be read or contains values that are not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnBadPhrase {
    /// Stop with an error.
    Error,
    /// Leave the phrase out with a warning.
    Skip,
}

/// Phrases held out for validation. `patterns` and `ids_file` take precedence over `fraction`.
/// Without all three, the `split` column of the manifest decides, or a tenth is held out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSplit {
    /// Share of held-out phrases, by a hash of each id: adding phrases moves no other phrase.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fraction: Option<f64>,
    /// Ids, or patterns with `*`, such as `"C_5_*"`.
    pub patterns: Vec<String>,
    /// File with one id or pattern per line; empty lines and lines beginning with `#` are ignored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ids_file: Option<String>,
}

/// Caches, which change speed and memory, but no batch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CacheConfig {
    /// Memory limit of cached phrases, MiB (0.09 for 120 frames). Held-out phrases always stay in
    /// memory.
    pub memory_mib: usize,
    /// Size limit of the disk cache of remote files for all runs, MiB; 0 disables the cache.
    pub disk_mib: u64,
    /// Folder of the disk cache, by default `$XDG_CACHE_HOME/kinegrad` or `~/.cache/kinegrad`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dir: Option<String>,
}

impl Default for CacheConfig {
    fn default() -> Self {
        Self {
            memory_mib: 1024,
            disk_mib: 10_240,
            dir: None,
        }
    }
}

impl CacheConfig {
    /// The cache's folder; `None` if the system defines no cache location.
    pub(crate) fn folder(&self) -> Option<PathBuf> {
        let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
        let named = |name| named(name).map(PathBuf::from);
        let caches = || named("XDG_CACHE_HOME").or_else(|| Some(named("HOME")?.join(".cache")));
        let dir = self.dir.as_ref().map(PathBuf::from);
        dir.or_else(|| Some(caches()?.join("kinegrad")))
    }
}

/// Access to buckets and web servers. Credentials come from the environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StoreConfig {
    /// Base URL of an emulator or another provider.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub endpoint: Option<String>,
    /// Send no credentials, for public buckets and emulators.
    pub anonymous: bool,
    /// Timeout of a request that receives no data, seconds.
    pub timeout_seconds: f64,
    /// Number of retries of a failed request, with exponential backoff from 0.1 s to 20 s.
    pub max_retries: usize,
    /// Maximum number of concurrent requests, and of phrases of a batch that are read in parallel.
    pub concurrency: usize,
}

impl Default for StoreConfig {
    fn default() -> Self {
        Self {
            endpoint: None,
            anonymous: false,
            timeout_seconds: 30.0,
            max_retries: 9,
            concurrency: 16,
        }
    }
}

/// Random changes to training samples, off by default. Validation is never augmented.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Rotate the motion about the vertical by a random angle.
    pub rotate_yaw: bool,
    /// Mirror the motion left to right in half of the samples.
    pub mirror: bool,
    /// Negate all quaternions in half of the samples; q and -q are the same orientation.
    pub flip_quaternion: bool,
    /// Crop each sample to a random window of at least this many frames and pad the rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_frames: Option<usize>,
    /// Standard deviation of Gaussian noise on the audio features.
    pub audio_noise: f64,
    /// Number of time masks (each up to a fifth of the sample) and of feature masks (each up to a
    /// quarter of the features), as in SpecAugment (Park et al. 2019,
    /// <https://arxiv.org/abs/1904.08779>). Beat features are not masked.
    pub audio_masks: usize,
    /// Probability of replacing a sample's audio features by normal noise.
    pub audio_replace_prob: f64,
    /// Probability of hiding the downbeat in beat features. `kinegrad sample --audio` has no
    /// downbeat without `--downbeat`.
    pub bar_drop_prob: f64,
    /// Largest relative change of the speed of motion and music: 0.25 samples speeds from 1 / 1.25
    /// to 1.25. Style numbers stay unchanged.
    pub speed: f64,
    /// Probability of bending the trajectory of a clip at random, with locked feet
    /// (docs/sources.md, section 7, option E).
    pub path_warp_prob: f64,
}

/// Size and seed of the synthetic dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Number of phrases.
    pub phrases: usize,
    /// Frames of each phrase, at 30 frames per second.
    pub frames: usize,
    /// Seed of the dances and their music.
    pub seed: u64,
}

impl Default for SyntheticConfig {
    fn default() -> Self {
        Self {
            phrases: 64,
            frames: 120,
            seed: 0,
        }
    }
}

/// Maximum number of values per frame of any item.
const NUMBERS_A_FRAME: u64 = 280;

impl DataConfig {
    /// The audio features of the model's condition.
    pub fn audio_layout(&self) -> AudioLayout {
        AudioLayout::of(&self.audio_features)
    }

    /// Approximate memory of prefetched batches and of items without files, bytes.
    pub fn memory(&self) -> u64 {
        let frames = |items: usize, frames: usize| items as u64 * frames as u64;
        let synthetic = match self.kind {
            DataKind::Phrases | DataKind::Humanml3d => 0,
            _ => frames(self.synthetic.phrases, self.synthetic.frames),
        };
        let batches = 1 + LOOK_AHEAD_PER_WORKER * self.num_workers;
        let ahead = frames(batches * self.batch_size, self.target_frames);
        (synthetic + ahead) * NUMBERS_A_FRAME * size_of::<f32>() as u64
    }

    /// Checks every value that needs no open file. Fails with [`Error::Config`], which names the
    /// key; [`Error::Scheme`] for an unknown kind of source.
    pub fn validate(&self) -> Result<(), Error> {
        in_range("data.target_frames", self.target_frames, FRAMES)
            .hint("30 frames are one second; 120 is the usual phrase")?;
        check_groups("data.audio_features", &self.audio_features)?;
        in_range("data.batch_size", self.batch_size, 1..=65_536).hint("16 or 32 suit most runs")?;
        in_range("data.num_workers", self.num_workers, 0..=256)
            .hint("0 loads in the trainer's own thread; the batches are the same for any number")?;
        in_range("data.num_phrases", self.num_phrases.unwrap_or(1), 1..)
            .hint("leave the key out to use every phrase")?;
        if self.kind.has_source() {
            let allowed = "a folder, file://, gs://, s3://, http:// or https:// URI";
            let missing = || InvalidSetting::new("data.source", "(nothing)", allowed);
            let source = self.source.as_deref().ok_or_else(missing).hint(
                "name a folder: data.source = \"PATH\"; data.kind = \
                 \"synthetic\" and \"synthetic_walks\" need none",
            );
            Location::parse(source?)?;
        } else {
            self.synthetic.validate()?;
        }
        if self.kind.is_clips() {
            clips::validate(self)?;
        } else {
            let (key, prob) = ("data.augment.path_warp_prob", self.augment.path_warp_prob);
            require(prob == 0.0, key, prob, "0 with phrases")
                .hint("it is for clips of joint features")?;
        }
        check_patterns(&self.labels)?;
        self.validation.validate()?;
        self.cache.validate()?;
        self.store.validate()?;
        Ok(self.augment.validate(self.target_frames)?)
    }
}

impl ValidationSplit {
    fn validate(&self) -> Result<(), InvalidSetting> {
        let share = self.fraction.unwrap_or_default();
        in_range("data.validation.fraction", share, 0.0..1.0)
            .hint("0.1 holds out a tenth of the phrases, 0 none")?;
        let named = !self
            .patterns
            .iter()
            .any(|pattern| pattern.trim().is_empty());
        let allowed = "ids, or patterns with `*`";
        require(named, "data.validation.patterns", "\"\"", allowed).hint("remove the empty pattern")
    }
}

impl CacheConfig {
    fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("data.cache.memory_mib", self.memory_mib, 0..=1 << 24)
            .hint("1024 is a gibibyte")?;
        in_range("data.cache.disk_mib", self.disk_mib, 0..=1 << 30)
            .hint("10240 are ten gibibytes, 0 keeps nothing")
    }
}

impl StoreConfig {
    /// The error names the first key that is out of range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        if let Some(endpoint) = &self.endpoint {
            require(
                endpoint.starts_with("http://") || endpoint.starts_with("https://"),
                "data.store.endpoint",
                format!("\"{endpoint}\""),
                "an http:// or https:// address",
            )
            .hint("leave the key out to use the service itself")?;
        }
        let seconds = self.timeout_seconds;
        in_range("data.store.timeout_seconds", seconds, 0.01..=3600.0)
            .hint("30 suits most networks")?;
        in_range("data.store.max_retries", self.max_retries, 0..=100)
            .hint("6 is some ten seconds of trying")?;
        in_range("data.store.concurrency", self.concurrency, 1..=1024)
            .hint("16 keeps most connections busy")
    }
}

impl AugmentConfig {
    fn validate(&self, target_frames: usize) -> Result<(), InvalidSetting> {
        if let Some(min_frames) = self.min_frames {
            let lengths = MIN_FRAMES..=target_frames;
            in_range("data.augment.min_frames", min_frames, lengths)
                .hint("at most `data.target_frames`; leave the key out to use whole crops")?;
        }
        in_range("data.augment.audio_noise", self.audio_noise, 0.0..=100.0)
            .hint("most features lie in [0, 1]: try 0.05")?;
        let replaced = self.audio_replace_prob;
        in_range("data.augment.audio_replace_prob", replaced, 0.0..=1.0)
            .hint("0.1 is one sample in ten")?;
        in_range("data.augment.bar_drop_prob", self.bar_drop_prob, 0.0..=1.0)
            .hint("0.5 trains for songs with and without a known downbeat")?;
        in_range("data.augment.speed", self.speed, 0.0..=1.0)
            .hint("0.25 plays at 0.8 to 1.25 times the recorded speed")?;
        let warped = self.path_warp_prob;
        in_range("data.augment.path_warp_prob", warped, 0.0..=1.0)
            .hint("0.5 bends half of the clips")?;
        in_range("data.augment.audio_masks", self.audio_masks, 0..=16).hint("1 or 2 are usual")
    }
}

impl SyntheticConfig {
    /// Fails for zero phrases, and for phrases that are too short or too long.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("data.synthetic.phrases", self.phrases, 1..=1_000_000)
            .hint("64 phrases are enough to see a small model learn")?;
        in_range("data.synthetic.frames", self.frames, FRAMES)
            .hint("30 frames are one second; 120 is the usual phrase")
    }
}

#[cfg(test)]
mod tests;
