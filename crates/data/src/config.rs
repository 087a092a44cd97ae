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

/// Fewest frames a sample may have: the third difference of the jerk check needs four.
pub const MIN_FRAMES: usize = 4;

/// The frames that a sample may have.
const FRAMES: RangeInclusive<usize> = MIN_FRAMES..=crate::MAX_FRAMES;

/// The dataset and its loading. What is said of phrases also applies to [clips](crate::humanml),
/// unless stated otherwise.
///
/// Defaults follow CC-MotionGen, sections 6.1 and 6.3 (120 frames, batches of 32, four workers).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Kind of the dataset.
    pub kind: DataKind,
    /// Location of the dataset: a folder as a path or `file://` URI, a bucket as
    /// `gs://BUCKET/PREFIX` or `s3://BUCKET/PREFIX`, a web server as `http://` or `https://`.
    /// Needed for `kind = "phrases"` and `kind = "humanml3d"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Groups of audio features that the model hears: `["document"]`, the 163 of CC-MotionGen, or
    /// `["document", "beats"]`, with position in beat and bar, beat marks and local tempo beside
    /// them, which a dataset must have been prepared with.
    pub audio_features: Vec<AudioGroup>,
    /// Frames of a sample (30 per second; 20 in HumanML3D, where 196 is common). Longer phrases are
    /// cropped, shorter ones padded and masked.
    pub target_frames: usize,
    /// Cropping of longer phrases.
    pub crop: Crop,
    /// What motion is normalised by, for recipes on phrases. Fine-tuning takes the normalisation of
    /// what it starts from.
    pub statistics: StatisticsOf,
    /// Joins training phrases of one recording that follow each other, which are known by ids of
    /// the form `NAME_FIRSTFRAME`, so that random crops may begin anywhere up to half a phrase
    /// before or after a phrase's own first frame.
    pub join_neighbours: bool,
    /// Samples in a batch; may exceed the number of phrases.
    pub batch_size: usize,
    /// Threads that prefetch batches; with 0 each batch is prepared on demand, on all cores.
    pub num_workers: usize,
    /// What to do with unusable phrases.
    pub on_bad_phrase: OnBadPhrase,
    /// Use only this many ids, in sorted order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub num_phrases: Option<usize>,
    /// Labels of phrases, such as the kind of dance, for networks with `model.style`: a label for each
    /// id or pattern with `*`, of which the longest that matches decides. They go before those of
    /// the dataset's manifest; an empty one is none.
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
    /// How the clips of `kind = "humanml3d"` and `kind = "synthetic_walks"` are read.
    pub humanml3d: Humanml3dConfig,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            kind: DataKind::Phrases,
            source: None,
            audio_features: AudioLayout::DOCUMENT.groups(),
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

/// What the mean, deviation and range that normalise motion are measured of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StatisticsOf {
    /// Whole training phrases, as stored.
    #[default]
    Phrases,
    /// What training sees: crops of them, moved to the origin and augmented. The same crops whatever
    /// the run's seed.
    Crops,
}

/// What to do with a phrase that cannot be read or holds a number that is not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnBadPhrase {
    /// Stop with an error.
    Error,
    /// Leave it out, and name it when training starts.
    Skip,
}

/// Which phrases are held out for validation. `patterns` and `ids_file` add up. When neither is
/// given, `fraction` decides; without that the `split` column of the dataset's manifest, and where
/// there is none, a tenth of the phrases are held out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSplit {
    /// Share of the phrases held out, chosen by a hash of each id alone, so that adding phrases
    /// never moves another one across the split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fraction: Option<f64>,
    /// Ids, or patterns with `*` for any run of characters: `"C_5_*"`.
    pub patterns: Vec<String>,
    /// A file with one id or pattern a line; empty lines and lines that begin with `#` are passed
    /// over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ids_file: Option<String>,
}

/// Caches. They change speed and memory, never a batch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CacheConfig {
    /// Maximum size of phrases in memory, in MiB; a phrase of 120 frames takes 0.09. The held-out
    /// phrases are always kept.
    pub memory_mib: usize,
    /// Maximum size of remote files on disk, in MiB, for all runs together; 0 disables it.
    pub disk_mib: u64,
    /// The folder they are kept in. By default `kinegrad` in `XDG_CACHE_HOME`, else in `~/.cache`.
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
        if let Some(dir) = &self.dir {
            return Some(PathBuf::from(dir));
        }
        let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
        let caches = named("XDG_CACHE_HOME")
            .map(PathBuf::from)
            .or_else(|| named("HOME").map(|home| PathBuf::from(home).join(".cache")));
        caches.map(|folder| folder.join("kinegrad"))
    }
}

/// Access to buckets and web servers. Credentials come from the environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StoreConfig {
    /// Base URL to use instead of the service's own, for emulators and other providers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub endpoint: Option<String>,
    /// Send no credentials: for public buckets and emulators.
    pub anonymous: bool,
    /// Seconds without data after which a request times out.
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

/// Random changes to training samples; all off by default. Validation is never augmented.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Rotate the motion about the vertical axis by a random angle from [0, 2 pi).
    pub rotate_yaw: bool,
    /// Mirror the motion left to right in half of the samples.
    pub mirror: bool,
    /// Negate the whole quaternion sequence in half of the samples: q and -q are the same
    /// orientation, and the choice between them is arbitrary.
    pub flip_quaternion: bool,
    /// Cut a random window of at least this many frames out of the crop; the rest of the sample is
    /// padding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_frames: Option<usize>,
    /// Standard deviation of Gaussian noise added to the audio features.
    pub audio_noise: f64,
    /// Number of time masks, each up to a fifth of the sample, and of masks over adjacent features,
    /// each up to a quarter of them (SpecAugment, Park et al. 2019,
    /// <https://arxiv.org/abs/1904.08779>). Beat features are not masked.
    pub audio_masks: usize,
    /// Probability of replacing a sample's audio features by standard normal noise, for robustness
    /// to unfamiliar music.
    pub audio_replace_prob: f64,
    /// Probability of hiding from a sample which beat begins a bar, of datasets with beat features:
    /// `kinegrad sample --audio` does not know it without `--downbeat`.
    pub bar_drop_prob: f64,
    /// Play motion and music together faster or slower: 0.25 draws a speed between 1 / 1.25 and 1.25
    /// for each sample. Style numbers stay those of the recorded speed.
    pub speed: f64,
    /// Probability of bending the way of a clip of joint features at random: turns of the whole way and
    /// waves, the body turned along and feet held (docs/sources.md, section 7, option E).
    pub path_warp_prob: f64,
}

/// Size and seed of the synthetic dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Number of phrases.
    pub phrases: usize,
    /// Frames of each (30 per second).
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

/// Numbers that a frame of an item has, of whichever kind, at most: 263 joint features and what is
/// known of the frame.
const NUMBERS_A_FRAME: u64 = 280;

impl DataConfig {
    /// The audio features that the model hears.
    pub fn audio_layout(&self) -> AudioLayout {
        AudioLayout::of(&self.audio_features)
    }

    /// Bytes of memory that the items of a dataset without files and the batches that are made
    /// ahead take, roughly.
    pub fn memory(&self) -> u64 {
        let frames = |items: usize, frames: usize| items as u64 * frames as u64;
        let made_up = match self.kind {
            DataKind::Synthetic | DataKind::SyntheticWalks => {
                frames(self.synthetic.phrases, self.synthetic.frames)
            }
            DataKind::Phrases | DataKind::Humanml3d => 0,
        };
        let batches = 1 + LOOK_AHEAD_PER_WORKER * self.num_workers;
        let ahead = frames(batches * self.batch_size, self.target_frames);
        (made_up + ahead) * NUMBERS_A_FRAME * size_of::<f32>() as u64
    }

    /// Checks every value that can be checked without opening a file.
    ///
    /// # Errors
    /// [`Error::Config`] names the key, what was found and what is allowed; [`Error::Scheme`] a
    /// source that is of no known kind.
    pub fn validate(&self) -> Result<(), Error> {
        in_range("data.target_frames", self.target_frames, FRAMES)
            .hint("30 frames are one second; 120 is the usual phrase")?;
        check_groups("data.audio_features", &self.audio_features)?;
        in_range("data.batch_size", self.batch_size, 1..=65_536).hint("16 or 32 suit most runs")?;
        in_range("data.num_workers", self.num_workers, 0..=256)
            .hint("0 loads in the trainer's own thread; the batches are the same for any number")?;
        in_range("data.num_phrases", self.num_phrases.unwrap_or(1), 1..)
            .hint("leave the key out to use every phrase")?;
        if matches!(self.kind, DataKind::Phrases | DataKind::Humanml3d) {
            Location::parse(self.named_source()?)?;
        } else {
            self.synthetic.validate()?;
        }
        if matches!(self.kind, DataKind::Humanml3d | DataKind::SyntheticWalks) {
            clips::validate(self)?;
        } else {
            let prob = self.augment.path_warp_prob;
            require(
                prob == 0.0,
                "data.augment.path_warp_prob",
                prob,
                "0 with phrases",
            )
            .hint("it is for clips of joint features")?;
        }
        check_patterns(&self.labels)?;
        self.validation.validate()?;
        self.cache.validate()?;
        self.store.validate()?;
        Ok(self.augment.validate(self.target_frames)?)
    }

    fn named_source(&self) -> Result<&str, InvalidSetting> {
        let allowed = "a folder, file://, gs://, s3://, http:// or https:// URI";
        let missing = || InvalidSetting::new("data.source", "(nothing)", allowed);
        self.source.as_deref().ok_or_else(missing).hint(
            "name a folder: data.source = \"PATH\", or --set data.source=PATH; data.kind = \
             \"synthetic\" and \"synthetic_walks\" need none",
        )
    }
}

impl ValidationSplit {
    fn validate(&self) -> Result<(), InvalidSetting> {
        let share = self.fraction.unwrap_or_default();
        in_range("data.validation.fraction", share, 0.0..1.0)
            .hint("0.1 holds out a tenth of the phrases, 0 none")?;
        let named = self
            .patterns
            .iter()
            .all(|pattern| !pattern.trim().is_empty());
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
    /// # Errors
    /// Names the first key out of its range.
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
        in_range(
            "data.store.timeout_seconds",
            self.timeout_seconds,
            0.01..=3600.0,
        )
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
            in_range(
                "data.augment.min_frames",
                min_frames,
                MIN_FRAMES..=target_frames,
            )
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
        in_range(
            "data.augment.path_warp_prob",
            self.path_warp_prob,
            0.0..=1.0,
        )
        .hint("0.5 bends every second way")?;
        in_range("data.augment.audio_masks", self.audio_masks, 0..=16).hint("1 or 2 are usual")
    }
}

impl SyntheticConfig {
    /// # Errors
    /// For no phrases, or phrases too short or too long.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("data.synthetic.phrases", self.phrases, 1..=1_000_000)
            .hint("64 phrases are enough to see a small model learn")?;
        in_range("data.synthetic.frames", self.frames, FRAMES)
            .hint("30 frames are one second; 120 is the usual phrase")
    }
}

#[cfg(test)]
mod tests;
