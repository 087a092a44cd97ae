//! A dataset in memory: every phrase read, checked and put on its side of the split.

use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;

use crate::phrase::Listing;
use crate::split::Split;
use crate::{DataConfig, DataKind, Error, FileError, OnBadPhrase, Phrase, local_folder, synthetic};

/// The phrases of a dataset, sorted by id within each side of the split.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Phrases to train on; at least one.
    pub train: Vec<Arc<Phrase>>,
    /// Phrases held out; may be none.
    pub validation: Vec<Arc<Phrase>>,
    /// Id and reason of each bad phrase left out under `on_bad_phrase = "skip"`.
    pub skipped: Vec<(String, String)>,
    /// What a user should hear of without the run being stopped: unequal lengths of motion and
    /// audio, unpaired folders, validation patterns that match nothing.
    pub warnings: Vec<String>,
}

impl Dataset {
    /// Opens the dataset that `config` describes, reading all phrases in parallel.
    ///
    /// Bad phrases are reported before anything is said of the split.
    ///
    /// # Errors
    /// [`Error::Config`] and [`Error::Scheme`] for settings out of range;
    /// [`Error::MissingFolder`], [`Error::EmptyDataset`], [`Error::Io`] for a dataset that is not
    /// there; [`Error::BadPhrase`] for the first bad phrase by id, or [`Error::AllSkipped`];
    /// [`Error::EmptyTrainSplit`].
    pub fn open(config: &DataConfig) -> Result<Self, Error> {
        config.validate()?;
        let split = Split::new(&config.validation)?;
        let Gathered {
            phrases,
            mut warnings,
            ..
        } = gather(config)?;
        let listed: Vec<&str> = phrases.iter().map(|(id, _)| id.as_str()).collect();
        warnings.extend(split.idle_entries(&listed));
        let mut good = Vec::with_capacity(phrases.len());
        let mut skipped = Vec::new();
        for (id, result) in phrases {
            match result {
                Ok((phrase, note)) => {
                    warnings.extend(note.map(|note| format!("phrase `{id}`: {note}")));
                    good.push(Arc::new(phrase));
                }
                Err(cause) if config.on_bad_phrase == OnBadPhrase::Skip => {
                    skipped.push((id, cause.to_string()));
                }
                Err(cause) => {
                    return Err(Error::BadPhrase {
                        id,
                        cause: Box::new(cause),
                    });
                }
            }
        }
        if let (true, Some((id, reason))) = (good.is_empty(), skipped.first()) {
            let first = format!("phrase `{id}`: {reason}");
            return Err(Error::AllSkipped {
                skipped: skipped.len(),
                first,
            });
        }
        let (validation, train): (Vec<_>, Vec<_>) = good
            .into_iter()
            .partition(|phrase| split.holds_out(&phrase.id));
        if train.is_empty() {
            return Err(Error::EmptyTrainSplit {
                phrases: validation.len(),
            });
        }
        Ok(Self {
            train,
            validation,
            skipped,
            warnings,
        })
    }

    /// The dataset of [synthetic phrases](crate::synthetic) that `config.synthetic` describes,
    /// whatever `config.kind` says.
    ///
    /// # Errors
    /// As [`Dataset::open`].
    pub fn synthetic(config: &DataConfig) -> Result<Self, Error> {
        Self::open(&DataConfig {
            kind: DataKind::Synthetic,
            ..config.clone()
        })
    }

    /// The phrase `id`, from either side of the split.
    pub fn find(&self, id: &str) -> Option<&Arc<Phrase>> {
        self.train
            .iter()
            .chain(&self.validation)
            .find(|phrase| phrase.id == id)
    }
}

/// A phrase with its note, or why it cannot be used.
pub(crate) type Read = Result<(Phrase, Option<String>), FileError>;

/// All phrases of a dataset, good and bad.
pub(crate) struct Gathered {
    /// Id and outcome, sorted by id.
    pub phrases: Vec<(String, Read)>,
    /// What is odd about the dataset's folders.
    pub warnings: Vec<String>,
    /// The dataset's folder, unless it is synthetic.
    pub folder: Option<PathBuf>,
}

/// Reads or makes up every phrase of a valid `config`, none refused.
///
/// # Errors
/// [`Error::MissingFolder`], [`Error::EmptyDataset`], [`Error::Io`].
pub(crate) fn gather(config: &DataConfig) -> Result<Gathered, Error> {
    let limit = config.num_phrases.unwrap_or(usize::MAX);
    if config.kind == DataKind::Synthetic {
        let wanted = &config.synthetic;
        let phrases = (0..wanted.phrases.min(limit))
            .into_par_iter()
            .map(|index| {
                let phrase = synthetic::phrase(index, wanted.frames, wanted.seed);
                (phrase.id.clone(), Ok((phrase, None)))
            })
            .collect();
        return Ok(Gathered {
            phrases,
            warnings: Vec::new(),
            folder: None,
        });
    }
    let folder = local_folder(config.source.as_deref().unwrap_or_default())?;
    let Listing {
        mut ids,
        only_motion,
        only_audio,
    } = Listing::read(&folder)?;
    if ids.is_empty() {
        return Err(Error::EmptyDataset {
            path: folder,
            only_motion: only_motion.len(),
            only_audio: only_audio.len(),
        });
    }
    let mut warnings = Vec::new();
    for (alone, place, lacking) in [
        (&only_motion, "motion", "audio_features"),
        (&only_audio, "audio_features", "motion"),
    ] {
        if let Some(first) = alone.first() {
            let count = alone.len();
            warnings.push(format!(
                "{count} folder(s) under {place}/ have no counterpart under {lacking}/ and are left \
                 out, the first: {first}"
            ));
        }
    }
    ids.truncate(limit);
    let phrases = ids
        .into_par_iter()
        .map(|id| {
            let read = Phrase::load(&folder, &id);
            (id, read)
        })
        .collect();
    Ok(Gathered {
        phrases,
        warnings,
        folder: Some(folder),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::{features_path, motion_path};
    use std::fs;
    use std::path::Path;

    fn dataset(phrases: usize) -> (tempfile::TempDir, DataConfig) {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), phrases, 12, 5).unwrap();
        let config = DataConfig {
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        (folder, config)
    }

    fn ids(phrases: &[Arc<Phrase>]) -> Vec<&str> {
        phrases.iter().map(|phrase| phrase.id.as_str()).collect()
    }

    fn spoil(folder: &Path, index: usize) {
        let path = motion_path(folder, &synthetic::id(index));
        let mut motion = crate::read_motion(&path).unwrap();
        motion.frame_mut(3)[16] = f32::INFINITY;
        crate::write_motion(&path, &motion).unwrap();
    }

    #[test]
    fn a_written_synthetic_dataset_is_the_one_made_in_memory() {
        let (_folder, config) = dataset(6);
        let read = Dataset::open(&config).unwrap();
        let mut made = config.clone();
        made.synthetic = crate::SyntheticConfig {
            phrases: 6,
            frames: 12,
            seed: 5,
        };
        let made = Dataset::synthetic(&made).unwrap();
        assert_eq!(read.train, made.train);
        assert_eq!(read.validation, made.validation);
        assert_eq!(read.train.len() + read.validation.len(), 6);
        assert!(read.warnings.is_empty() && read.skipped.is_empty());
    }

    #[test]
    fn listed_phrases_are_held_out_and_found_again() {
        let (_folder, mut config) = dataset(12);
        config.validation.patterns = vec!["*_00003".into(), "*1?".into(), "*_0001*".into()];
        let read = Dataset::open(&config).unwrap();
        assert_eq!(
            ids(&read.validation),
            ["synthetic_00003", "synthetic_00010", "synthetic_00011"]
        );
        assert_eq!(read.train.len(), 9);
        assert_eq!(read.warnings, ["data.validation: `*1?` matches no phrase"]);
        assert_eq!(read.find("synthetic_00010").unwrap().id, "synthetic_00010");
        assert_eq!(read.find("synthetic_00004").unwrap().id, "synthetic_00004");
        assert!(read.find("nobody").is_none());
    }

    #[test]
    fn a_bad_phrase_is_named_before_an_empty_split_or_left_out_and_counted() {
        let (folder, mut config) = dataset(4);
        spoil(folder.path(), 2);
        config.validation.patterns = vec!["*".into()];
        let message = Dataset::open(&config).unwrap_err().to_string();
        assert!(message.contains("phrase `synthetic_00002`"), "{message}");
        assert!(message.contains("frame 3, channel phase"), "{message}");

        config.on_bad_phrase = OnBadPhrase::Skip;
        let error = Dataset::open(&config).unwrap_err();
        assert!(
            matches!(error, Error::EmptyTrainSplit { phrases: 3 }),
            "{error}"
        );

        config.validation.patterns = vec!["*_00000".into()];
        let read = Dataset::open(&config).unwrap();
        assert_eq!(ids(&read.train), ["synthetic_00001", "synthetic_00003"]);
        assert_eq!(read.skipped.len(), 1);
        assert_eq!(read.skipped[0].0, "synthetic_00002");
        assert!(
            read.skipped[0].1.contains("channel phase"),
            "{:?}",
            read.skipped
        );

        (0..2)
            .chain(3..4)
            .for_each(|index| spoil(folder.path(), index));
        let error = Dataset::open(&config).unwrap_err();
        assert!(
            matches!(error, Error::AllSkipped { skipped: 4, .. }),
            "{error}"
        );
    }

    #[test]
    fn missing_and_cut_off_files_are_bad_phrases() {
        let (folder, config) = dataset(3);
        let features = features_path(folder.path(), "synthetic_00001");
        let bytes = fs::read(&features).unwrap();
        fs::write(&features, &bytes[..bytes.len() / 2]).unwrap();
        let message = Dataset::open(&config).unwrap_err().to_string();
        assert!(
            message.contains("`synthetic_00001`") && message.contains("features.npz"),
            "{message}"
        );
        fs::remove_file(motion_path(folder.path(), "synthetic_00000")).unwrap();
        let message = Dataset::open(&config).unwrap_err().to_string();
        assert!(
            message.contains("`synthetic_00000`") && message.contains("cannot be read"),
            "{message}"
        );
    }

    #[test]
    fn missing_and_empty_datasets_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let open = |path: &Path| {
            let source = Some(path.display().to_string());
            Dataset::open(&DataConfig {
                source,
                ..DataConfig::default()
            })
            .unwrap_err()
        };
        let missing = open(&folder.path().join("nowhere"));
        assert!(matches!(missing, Error::MissingFolder { .. }), "{missing}");
        fs::create_dir_all(folder.path().join("motion/a")).unwrap();
        let half = open(folder.path()).to_string();
        assert!(half.contains("audio_features not found"), "{half}");
        fs::create_dir_all(folder.path().join("audio_features/b")).unwrap();
        let empty = open(folder.path());
        assert!(
            matches!(
                empty,
                Error::EmptyDataset {
                    only_motion: 1,
                    only_audio: 1,
                    ..
                }
            ),
            "{empty}"
        );
        assert!(empty.to_string().contains("1 only in motion/"), "{empty}");
    }

    #[test]
    fn unpaired_folders_are_warned_of_and_the_limit_takes_the_first_ids() {
        let (folder, mut config) = dataset(5);
        fs::create_dir_all(folder.path().join("motion/zz")).unwrap();
        config.num_phrases = Some(2);
        config.validation.fraction = 0.0;
        let read = Dataset::open(&config).unwrap();
        assert_eq!(ids(&read.train), ["synthetic_00000", "synthetic_00001"]);
        assert!(read.warnings[0].contains("zz"), "{:?}", read.warnings);
    }
}
