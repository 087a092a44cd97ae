//! The `data` table of a training config.

use serde::{Deserialize, Serialize};

use crate::Error;

/// Fewest frames a sample may have: the third difference of the jerk check needs four.
pub const MIN_FRAMES: usize = 4;

/// Where the phrases come from and how batches are made of them.
///
/// Defaults follow CC-MotionGen, sections 6.1 and 6.3 (120 frames, batches of 32, four workers).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Phrases from files, or made up.
    pub kind: DataKind,
    /// The dataset's folder, as a path or a `file://` URI. Needed for `kind = "phrases"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Frames of a sample (30 a second). Longer phrases are cropped, shorter ones padded and masked.
    pub target_frames: usize,
    /// Which part of a longer phrase a sample takes.
    pub crop: Crop,
    /// Joins training phrases of one recording that follow each other, which are known by ids of
    /// the form `NAME_FIRSTFRAME`, so that random crops may begin anywhere up to half a phrase
    /// before or after a phrase's own first frame.
    pub join_neighbours: bool,
    /// Samples in a batch; may exceed the number of phrases.
    pub batch_size: usize,
    /// Threads that prepare batches ahead; 0 prepares them in the trainer's own thread.
    pub num_workers: usize,
    /// Whether a phrase that cannot be used ends the run.
    pub on_bad_phrase: OnBadPhrase,
    /// Use only the first so many ids, in sorted order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub num_phrases: Option<usize>,
    /// Which phrases are held out.
    pub validation: ValidationSplit,
    /// Changes made to training samples.
    pub augment: AugmentConfig,
    /// The made-up phrases of `kind = "synthetic"`.
    pub synthetic: SyntheticConfig,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            kind: DataKind::Phrases,
            source: None,
            target_frames: 120,
            crop: Crop::Random,
            join_neighbours: false,
            batch_size: 32,
            num_workers: 4,
            on_bad_phrase: OnBadPhrase::Error,
            num_phrases: None,
            validation: ValidationSplit::default(),
            augment: AugmentConfig::default(),
            synthetic: SyntheticConfig::default(),
        }
    }
}

/// Kind of dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DataKind {
    /// The phrase layout of CC-MotionGen, section 1.3, read from [`DataConfig::source`].
    Phrases,
    /// [Synthetic phrases](crate::synthetic), no files needed.
    Synthetic,
}

/// Which `target_frames` of a longer phrase a training sample takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Crop {
    /// Another random window each time.
    Random,
    /// The first frames (CC-MotionGen, section 6.1).
    Leading,
}

/// What to do with a phrase that cannot be read or holds a number that is not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnBadPhrase {
    /// Stop and say what is wrong.
    Error,
    /// Leave it out, and count it in [`Dataset::skipped`](crate::Dataset::skipped).
    Skip,
}

/// Which phrases are held out for validation. `patterns` and `ids_file` add up; `fraction` is used
/// when neither is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSplit {
    /// Share of the phrases held out, chosen by a hash of each id alone, so that adding phrases
    /// never moves another one across the split.
    pub fraction: f64,
    /// Ids, or patterns with `*` for any run of characters: `"C_5_*"`.
    pub patterns: Vec<String>,
    /// A file with one id or pattern a line; empty lines and lines that begin with `#` are passed
    /// over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ids_file: Option<String>,
}

impl Default for ValidationSplit {
    fn default() -> Self {
        Self {
            fraction: 0.1,
            patterns: Vec::new(),
            ids_file: None,
        }
    }
}

/// Random changes to training samples; all off by default. Validation is never augmented.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Turn the motion about the vertical by an angle from [0, 2 pi).
    pub rotate_yaw: bool,
    /// Mirror the motion left to right in half of the samples.
    pub mirror: bool,
    /// Negate the whole quaternion sequence in half of the samples: q and -q are the same
    /// orientation, and a recording's choice between them says nothing.
    pub flip_quaternion: bool,
    /// Cut a random window of at least so many frames out of the crop; the rest of the sample is
    /// padding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_frames: Option<usize>,
    /// Standard deviation of Gaussian noise added to the audio features.
    pub audio_noise: f64,
    /// So many stretches of time, each up to a fifth of the sample, and as many bands of adjoining
    /// features, each up to a quarter of them, are set to zero (SpecAugment, Park et al. 2019,
    /// <https://arxiv.org/abs/1904.08779>).
    pub audio_masks: usize,
    /// With this probability a sample's audio features are standard normal noise instead, so that
    /// the model learns to dance to what it does not know.
    pub audio_replace_prob: f64,
}

/// Size and seed of the synthetic dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// How many phrases.
    pub phrases: usize,
    /// Frames of each (30 a second).
    pub frames: usize,
    /// Phrases of another seed are other dances to other music.
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

/// An [`Error::Config`] unless `holds`.
fn require(
    holds: bool,
    key: &'static str,
    found: impl ToString,
    allowed: &str,
    hint: &str,
) -> Result<(), Error> {
    if holds {
        return Ok(());
    }
    Err(Error::Config {
        key,
        found: found.to_string(),
        allowed: allowed.to_owned(),
        hint: hint.to_owned(),
    })
}

impl DataConfig {
    /// Checks every value that can be checked without opening a file.
    ///
    /// # Errors
    /// [`Error::Config`] names the key, what was found and what is allowed; [`Error::Scheme`] a
    /// source that is no local folder.
    pub fn validate(&self) -> Result<(), Error> {
        let frames = format!("a whole number from {MIN_FRAMES} to {}", crate::MAX_FRAMES);
        require(
            (MIN_FRAMES..=crate::MAX_FRAMES).contains(&self.target_frames),
            "data.target_frames",
            self.target_frames,
            &frames,
            "30 frames are one second; 120 is the usual phrase",
        )?;
        require(
            (1..=65_536).contains(&self.batch_size),
            "data.batch_size",
            self.batch_size,
            "a whole number from 1 to 65536",
            "16 or 32 suit most runs",
        )?;
        require(
            self.num_workers <= 256,
            "data.num_workers",
            self.num_workers,
            "a whole number from 0 to 256",
            "0 loads in the trainer's own thread; the batches are the same for any number",
        )?;
        require(
            self.num_phrases != Some(0),
            "data.num_phrases",
            0,
            "at least 1",
            "leave the key out to use every phrase",
        )?;
        match self.kind {
            DataKind::Phrases => self.validate_source()?,
            DataKind::Synthetic => self.synthetic.validate()?,
        }
        self.validation.validate()?;
        self.augment.validate(self.target_frames)
    }

    fn validate_source(&self) -> Result<(), Error> {
        let hint = "name a folder: data.source = \"PATH\", or --set data.source=PATH; \
                    data.kind = \"synthetic\" needs none";
        let Some(source) = &self.source else {
            return require(
                false,
                "data.source",
                "(nothing)",
                "a folder or file:// URI",
                hint,
            );
        };
        crate::source::local_folder(source).map(drop)
    }
}

impl ValidationSplit {
    fn validate(&self) -> Result<(), Error> {
        require(
            (0.0..1.0).contains(&self.fraction),
            "data.validation.fraction",
            self.fraction,
            "a number from 0 up to, not including, 1",
            "0.1 holds out a tenth of the phrases, 0 none",
        )?;
        require(
            self.patterns
                .iter()
                .all(|pattern| !pattern.trim().is_empty()),
            "data.validation.patterns",
            "\"\"",
            "ids, or patterns with `*`",
            "remove the empty pattern",
        )
    }
}

impl AugmentConfig {
    fn validate(&self, target_frames: usize) -> Result<(), Error> {
        if let Some(min_frames) = self.min_frames {
            require(
                (MIN_FRAMES..=target_frames).contains(&min_frames),
                "data.augment.min_frames",
                min_frames,
                &format!(
                    "a whole number from {MIN_FRAMES} to data.target_frames ({target_frames})"
                ),
                "leave the key out to use whole crops",
            )?;
        }
        require(
            (0.0..=100.0).contains(&self.audio_noise),
            "data.augment.audio_noise",
            self.audio_noise,
            "a number from 0 to 100",
            "most features lie in [0, 1]: try 0.05",
        )?;
        require(
            (0.0..=1.0).contains(&self.audio_replace_prob),
            "data.augment.audio_replace_prob",
            self.audio_replace_prob,
            "a number from 0 to 1",
            "0.1 is one sample in ten",
        )?;
        require(
            self.audio_masks <= 16,
            "data.augment.audio_masks",
            self.audio_masks,
            "a whole number from 0 to 16",
            "1 or 2 are usual",
        )
    }
}

impl SyntheticConfig {
    /// Checks the sizes.
    ///
    /// # Errors
    /// [`Error::Config`] for no phrases, or phrases too short or too long.
    pub fn validate(&self) -> Result<(), Error> {
        require(
            (1..=1_000_000).contains(&self.phrases),
            "data.synthetic.phrases",
            self.phrases,
            "a whole number from 1 to 1000000",
            "64 phrases are enough to see a small model learn",
        )?;
        require(
            (MIN_FRAMES..=crate::MAX_FRAMES).contains(&self.frames),
            "data.synthetic.frames",
            self.frames,
            &format!("a whole number from {MIN_FRAMES} to {}", crate::MAX_FRAMES),
            "30 frames are one second; 120 is the usual phrase",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phrases() -> DataConfig {
        DataConfig {
            source: Some("somewhere".into()),
            ..DataConfig::default()
        }
    }

    #[test]
    fn an_empty_table_gives_the_documented_defaults_and_survives_a_round_trip() {
        let config: DataConfig = toml::from_str("").unwrap();
        assert_eq!(config, DataConfig::default());
        assert_eq!(
            (config.target_frames, config.batch_size, config.num_workers),
            (120, 32, 4)
        );
        assert_eq!(config.validation.fraction, 0.1);
        let full = DataConfig {
            num_phrases: Some(7),
            augment: AugmentConfig {
                min_frames: Some(60),
                ..AugmentConfig::default()
            },
            ..phrases()
        };
        let text = toml::to_string(&full).unwrap();
        assert_eq!(toml::from_str::<DataConfig>(&text).unwrap(), full);
    }

    #[test]
    fn unknown_keys_and_wrong_types_are_refused() {
        for text in [
            "batchsize = 3",
            "validation.fractions = 0.1",
            "augment.mirrors = true",
            "synthetic.frame = 3",
            "batch_size = -1",
            "crop = \"middle\"",
        ] {
            assert!(toml::from_str::<DataConfig>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn values_out_of_range_are_refused_by_their_key() {
        type Change = fn(&mut DataConfig);
        let cases: [(&str, Change); 13] = [
            ("data.target_frames", |c| c.target_frames = 3),
            ("data.batch_size", |c| c.batch_size = 0),
            ("data.num_workers", |c| c.num_workers = 1000),
            ("data.num_phrases", |c| c.num_phrases = Some(0)),
            ("data.source", |c| c.source = None),
            ("data.validation.fraction", |c| c.validation.fraction = 1.0),
            ("data.validation.fraction", |c| {
                c.validation.fraction = f64::NAN
            }),
            ("data.validation.patterns", |c| {
                c.validation.patterns = vec![String::new()]
            }),
            ("data.augment.min_frames", |c| {
                c.augment.min_frames = Some(121)
            }),
            ("data.augment.audio_noise", |c| c.augment.audio_noise = -0.1),
            ("data.augment.audio_replace_prob", |c| {
                c.augment.audio_replace_prob = 1.5
            }),
            ("data.synthetic.phrases", |c| {
                c.kind = DataKind::Synthetic;
                c.synthetic.phrases = 0;
            }),
            ("data.synthetic.frames", |c| {
                c.kind = DataKind::Synthetic;
                c.synthetic.frames = 2;
            }),
        ];
        assert!(phrases().validate().is_ok());
        for (expected, change) in cases {
            let mut config = phrases();
            change(&mut config);
            match config.validate() {
                Err(Error::Config { key, .. }) => assert_eq!(key, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
