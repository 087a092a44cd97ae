//! A dataset: every phrase read once, checked and put on its side of the split.

use std::sync::Arc;

use crate::split::Split;
use crate::survey::{OpenProgress, Survey};
use crate::{Counters, DataConfig, DataKind, Digest, Error, LoaderReport, Phrase, PhraseSet};

/// The phrases of a dataset, sorted by id within each side of the split.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Phrases to train on; at least one.
    pub train: PhraseSet,
    /// Phrases held out; may be none.
    pub validation: PhraseSet,
    /// Id and reason of each bad phrase left out under `on_bad_phrase = "skip"`.
    pub skipped: Vec<(String, String)>,
    /// What a user should hear of without the run being stopped: unequal lengths of motion and
    /// audio, unpaired folders, validation patterns that match nothing.
    pub warnings: Vec<String>,
    /// A checksum of the ids, files and side of the split of all phrases used. Equal datasets have equal ones,
    /// wherever they lie.
    pub digest: Digest,
    counters: Arc<Counters>,
}

impl Dataset {
    /// Opens the dataset that `config` describes, reading all phrases in parallel.
    ///
    /// Bad phrases are reported before anything is said of the split.
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Scheme`] and [`Error::Feature`] for settings that cannot be
    /// followed; [`Error::MissingFolder`], [`Error::EmptyDataset`], [`Error::Manifest`],
    /// [`Error::Store`], [`Error::Io`] for a dataset that is not there or cannot be reached;
    /// [`Error::BadItem`] for the first bad phrase by id, or [`Error::AllSkipped`];
    /// [`Error::EmptyTrainSplit`].
    pub fn open(config: &DataConfig) -> Result<Self, Error> {
        Self::open_with_progress(config, &|_, _| {})
    }

    /// [`open`](Self::open), telling `progress` how far it is.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with_progress(config: &DataConfig, progress: OpenProgress) -> Result<Self, Error> {
        config.validate()?;
        let split = Split::new(&config.validation)?;
        let mut survey = Survey::phrases(config)?;
        let ids: Vec<&str> = survey.listed.iter().map(|item| item.id.as_str()).collect();
        let idle = split.idle_entries(&ids);
        let mut warnings = std::mem::take(&mut survey.warnings);
        warnings.extend(idle);
        let mut gathered = survey.gather(config, progress)?;
        let note = |(id, note): (String, String)| format!("phrase `{id}`: {note}");
        warnings.extend(std::mem::take(&mut gathered.notes).into_iter().map(note));
        let skipped = std::mem::take(&mut gathered.skipped);
        let counters = survey.counters.clone();
        let sides = survey.split(gathered, |entry| split.holds_out(&entry.id, entry.side))?;
        Ok(Self {
            train: sides.train,
            validation: sides.validation,
            skipped,
            warnings,
            digest: sides.digest,
            counters,
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

    /// Reads the phrase `id`, from either side of the split; `None` if there is none.
    ///
    /// # Errors
    /// As [`PhraseSet::get`].
    pub fn find(&self, id: &str) -> Result<Option<Arc<Phrase>>, Error> {
        match self.train.find(id)? {
            None => self.validation.find(id),
            found => Ok(found),
        }
    }

    /// What reading has cost since the dataset was opened.
    pub fn report(&self) -> LoaderReport {
        self.counters.report()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OnBadPhrase;
    use crate::{features_path, motion_path, synthetic};
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

    fn ids(phrases: &PhraseSet) -> Vec<&str> {
        phrases.ids().collect()
    }

    fn spoil(folder: &Path, index: usize) {
        let path = folder.join(motion_path(&synthetic::id(index)));
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
        assert_eq!(read.train.load().unwrap(), made.train.load().unwrap());
        assert_eq!(
            read.validation.load().unwrap(),
            made.validation.load().unwrap()
        );
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
        assert_eq!(
            read.find("synthetic_00010").unwrap().unwrap().id,
            "synthetic_00010"
        );
        assert_eq!(
            read.find("synthetic_00004").unwrap().unwrap().id,
            "synthetic_00004"
        );
        assert!(read.find("nobody").unwrap().is_none());
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
            matches!(error, Error::EmptyTrainSplit { items: 3, .. }),
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
        let features = folder.path().join(features_path("synthetic_00001"));
        let bytes = fs::read(&features).unwrap();
        fs::write(&features, &bytes[..bytes.len() / 2]).unwrap();
        let message = Dataset::open(&config).unwrap_err().to_string();
        assert!(
            message.contains("`synthetic_00001`") && message.contains("features.npz"),
            "{message}"
        );
        fs::remove_file(folder.path().join(motion_path("synthetic_00000"))).unwrap();
        let message = Dataset::open(&config).unwrap_err().to_string();
        assert!(
            message.contains("`synthetic_00000`") && message.contains("not found"),
            "{message}"
        );
    }

    #[test]
    fn a_file_that_cannot_be_read_is_a_bad_phrase_among_others() {
        let (folder, mut config) = dataset(4);
        let path = folder.path().join(motion_path(&synthetic::id(2)));
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        config.on_bad_phrase = OnBadPhrase::Skip;
        let read = Dataset::open(&config).unwrap();
        assert_eq!(read.skipped.len(), 1);
        assert!(
            read.skipped[0].1.contains("trajectory.npy"),
            "{:?}",
            read.skipped
        );
    }

    #[test]
    fn the_digest_knows_files_and_split_and_not_the_place() {
        let (folder, mut config) = dataset(6);
        let digest = |config: &DataConfig| Dataset::open(config).unwrap().digest;
        let first = digest(&config);
        let (_other, elsewhere) = dataset(6);
        assert_eq!(digest(&elsewhere), first);
        config.validation.patterns = vec!["*_00002".into()];
        let split = digest(&config);
        assert_ne!(split, first);
        let path = folder.path().join(motion_path(&synthetic::id(1)));
        let mut motion = crate::read_motion(&path).unwrap();
        motion.frame_mut(0)[0] += 1.0;
        crate::write_motion(&path, &motion).unwrap();
        assert_ne!(digest(&config), split);
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
        config.validation.fraction = Some(0.0);
        let read = Dataset::open(&config).unwrap();
        assert_eq!(ids(&read.train), ["synthetic_00000", "synthetic_00001"]);
        assert!(read.warnings[0].contains("zz"), "{:?}", read.warnings);
    }
}
