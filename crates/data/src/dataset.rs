//! A dataset: every item is read once, validated and assigned to a split.

use std::sync::Arc;

use kinegrad_motion::Statistics;
use kinegrad_ranks::{Alone, Sharing};
use kinegrad_settings::{counted, plural};

use crate::item::Item;
use crate::item_set::ItemSet;
use crate::progress::{OpenProgress, no_progress};
use crate::scan::Listable;
use crate::{DataConfig, Digest, Error, LoaderReport};

/// Maximum number of notes that are reported individually.
const NOTES: usize = 5;

/// Maximum number of ids in a hint.
const IDS: usize = 8;

/// The items of a dataset; each split is sorted by id.
#[derive(Debug)]
pub struct Dataset<T: Item> {
    /// Training items; at least one.
    pub train: ItemSet<T>,
    /// Held-out items.
    pub validation: ItemSet<T>,
    /// Representation of the motion.
    pub representation: T::Representation,
    /// Id and reason of each bad item that is skipped under `on_bad_phrase = "skip"`.
    pub skipped: Vec<(String, String)>,
    /// Id and reason of each valid item that is left out, such as a clip outside the length limits.
    pub left_out: Vec<(String, String)>,
    /// Warnings about the dataset, such as unpaired folders and unusable captions.
    pub warnings: Vec<String>,
    /// Checksum of the ids, files and split of all items and of other files that affect the
    /// training data. The location of the dataset does not change the checksum.
    pub digest: Digest,
    stored_statistics: Option<Statistics>,
}

#[expect(private_bounds, reason = "configs list the items of this crate alone")]
impl<T: Listable> Dataset<T> {
    /// Opens the dataset of `config` and reads all items in parallel. Fails with [`Error::Config`]
    /// for invalid settings or another `kind` of items; [`Error::Scheme`], [`Error::Feature`],
    /// [`Error::MissingFolder`], [`Error::Manifest`], [`Error::File`], [`Error::Store`],
    /// [`Error::Io`] for an unusable dataset; [`Error::BadItem`] for the first bad item by id;
    /// [`Error::NothingToTrainOn`].
    pub fn open(config: &DataConfig) -> Result<Self, Error> {
        Self::open_among(config, &no_progress, &Alone)
    }

    /// [`open`](Self::open) with `progress`; each rank reads a part of the items. Collective. Also
    /// fails with [`Error::Interrupted`]; [`Error::OtherListing`] if ranks list different items;
    /// [`Error::OtherReader`] if another rank failed.
    pub fn open_among(
        config: &DataConfig,
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<Self, Error> {
        config.validate()?;
        let mut scan = T::scan(config)?;
        let on_bad = Some(config.on_bad_phrase);
        let gathered = scan.gather(config, on_bad, progress, sharing)?;
        let kind = T::KIND;
        let named = |(id, reason): &(String, String)| format!("{kind} `{id}`: {reason}");
        let (skipped, left_out) = (&gathered.skipped, &gathered.left_out);
        if gathered.entries.is_empty()
            && let Some(first) = left_out.first().or(skipped.first()).map(named)
        {
            let (problem, hint) = match (left_out.len(), skipped.len()) {
                (0, skipped) => (
                    format!(
                        "data.on_bad_phrase = \"skip\" left none of {}",
                        counted(skipped, kind)
                    ),
                    format!("`kinegrad data inspect` lists what is wrong with each {kind}"),
                ),
                (clips, _) => (
                    format!("all {clips} clips are left out"),
                    "data.humanml3d.min_frames and data.humanml3d.max_frames set the lengths that \
                     are trained on"
                        .to_owned(),
                ),
            };
            let problem = format!("{problem}; the first: {first}");
            return Err(Error::NothingToTrainOn { problem, hint });
        }
        let mut warnings = std::mem::take(&mut scan.warnings);
        warnings.extend(gathered.notes.iter().map(named).take(NOTES));
        if gathered.notes.len() > NOTES {
            let more = gathered.notes.len() - NOTES;
            warnings.push(format!("{more} more {} of that sort", plural(more, kind)));
        }
        let representation = scan.representation.clone();
        let stored_statistics = scan.stored_statistics.take();
        let (train, validation, digest) = scan.divide(gathered.entries, gathered.memory);
        if train.is_empty() {
            let items = validation.len();
            return Err(Error::NothingToTrainOn {
                problem: format!(
                    "no training {kind}: all {items} {kind}s are held out for validation"
                ),
                hint:
                    "lower data.validation.fraction, list fewer data.validation.patterns, or for \
                       HumanML3D name another data.humanml3d.train_list"
                        .to_owned(),
            });
        }
        Ok(Self {
            train,
            validation,
            representation,
            skipped: gathered.skipped,
            left_out: gathered.left_out,
            warnings,
            digest,
            stored_statistics,
        })
    }
}

impl<T: Item> Dataset<T> {
    /// A dataset of items in memory. Panics without training items.
    pub fn of_items(
        train: Vec<Arc<T>>,
        validation: Vec<Arc<T>>,
        representation: T::Representation,
    ) -> Self {
        assert!(!train.is_empty(), "a dataset has an item to train on");
        let sides = [&train, &validation];
        let parts = sides.into_iter().flatten().map(|item| {
            let rows = item.rows(&representation);
            let bytes: Vec<u8> = rows.iter().flat_map(|value| value.to_le_bytes()).collect();
            [item.id().as_bytes().to_vec(), bytes].concat()
        });
        let parts: Vec<Vec<u8>> = parts.collect();
        let held_out = train.len().to_le_bytes();
        let parts = parts.iter().map(Vec::as_slice).chain([held_out.as_slice()]);
        Self {
            digest: Digest::of_parts(parts),
            train: train.into(),
            validation: validation.into(),
            representation,
            skipped: Vec::new(),
            left_out: Vec::new(),
            warnings: Vec::new(),
            stored_statistics: None,
        }
    }

    /// The statistics of the training items. A dataset's files of mean and standard deviation replace
    /// the measured normalization. Fails as [`ItemSet::get`].
    pub fn statistics(&self) -> Result<Statistics, Error> {
        self.statistics_among(&no_progress, &Alone)
    }

    /// [`statistics`](Self::statistics) with `progress`; each rank measures a part of the items.
    /// Collective. Also fails with [`Error::Interrupted`] and [`Error::OtherReader`].
    pub fn statistics_among(
        &self,
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<Statistics, Error> {
        let (train, rows) = (&self.train, &self.representation);
        let measured = train.statistics_among(rows, progress, sharing)?;
        let measured = measured.expect("a dataset has an item to train on");
        Ok(match &self.stored_statistics {
            Some(stored) => Statistics {
                mean: stored.mean.clone(),
                std: stored.std.clone(),
                range: stored.range.clone(),
                ..measured
            },
            None => measured,
        })
    }

    /// Reads the item `id` from either split. Fails as [`ItemSet::get`].
    pub fn find(&self, id: &str) -> Result<Option<Arc<T>>, Error> {
        match self.train.find(id)? {
            None => self.validation.find(id),
            found => Ok(found),
        }
    }

    /// A hint with ids, for an id that the dataset lacks.
    pub fn ids_hint(&self) -> String {
        let ids = self.validation.ids().chain(self.train.ids());
        let shown: Vec<String> = ids.take(IDS).map(|id| format!("`{id}`")).collect();
        let all = self.validation.len() + self.train.len();
        let more = match all - shown.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let shown = shown.join(", ");
        format!("it has {shown}{more}; `*` in an id stands for any characters")
    }

    /// The held-out items or, without held-out items, the training items.
    pub fn held_out(&self) -> &ItemSet<T> {
        match self.validation.is_empty() {
            true => &self.train,
            false => &self.validation,
        }
    }

    /// Loading statistics since the dataset was opened.
    pub fn report(&self) -> LoaderReport {
        self.train.counters().report()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DataKind, OnBadPhrase, PhraseItem, PhraseSet};
    use crate::{features_path, motion_path, synthetic};
    use std::fs;
    use std::ops::ControlFlow;
    use std::path::Path;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn dataset(phrases: usize) -> (tempfile::TempDir, DataConfig) {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, phrases, 12, 5)
            .unwrap();
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
        let read = Dataset::<PhraseItem>::open(&config).unwrap();
        let mut made = config.clone();
        made.kind = DataKind::Synthetic;
        made.synthetic = crate::SyntheticConfig {
            phrases: 6,
            frames: 12,
            seed: 5,
        };
        let made = Dataset::<PhraseItem>::open(&made).unwrap();
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
        let read = Dataset::<PhraseItem>::open(&config).unwrap();
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
        let message = Dataset::<PhraseItem>::open(&config)
            .unwrap_err()
            .to_string();
        assert!(message.contains("phrase `synthetic_00002`"), "{message}");
        assert!(message.contains("frame 3, channel phase"), "{message}");

        config.on_bad_phrase = OnBadPhrase::Skip;
        let message = Dataset::<PhraseItem>::open(&config)
            .unwrap_err()
            .to_string();
        assert!(message.contains("all 3 phrases are held out"), "{message}");

        config.validation.patterns = vec!["*_00000".into()];
        let read = Dataset::<PhraseItem>::open(&config).unwrap();
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
        let error = Dataset::<PhraseItem>::open(&config).unwrap_err();
        assert!(matches!(error, Error::NothingToTrainOn { .. }), "{error}");
        assert!(
            error.to_string().contains("left none of 4 phrases"),
            "{error}"
        );
    }

    #[test]
    fn opening_and_measuring_end_soon_when_they_are_interrupted() {
        let (_folder, config) = dataset(40);
        let after = |most: usize, read: &AtomicUsize| {
            let read = read.fetch_add(1, Ordering::SeqCst) + 1;
            match read < most {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        };
        let read = AtomicUsize::new(0);
        let opened = Dataset::<PhraseItem>::open_among(&config, &|_, _| after(3, &read), &Alone)
            .unwrap_err();
        assert!(matches!(opened, Error::Interrupted), "{opened}");
        assert!(read.load(Ordering::SeqCst) < 39);

        let dataset = Dataset::<PhraseItem>::open(&config).unwrap();
        let read = AtomicUsize::new(0);
        let measured = dataset.statistics_among(&|_, _| after(3, &read), &Alone);
        assert!(matches!(measured, Err(Error::Interrupted)));
        assert!(read.load(Ordering::SeqCst) < dataset.train.len());
        let statistics = dataset.statistics_among(&no_progress, &Alone);
        assert_eq!(statistics.unwrap(), dataset.statistics().unwrap());
    }

    /// The first of two ranks; the other rank lists different items.
    struct Apart;

    impl Sharing<Error> for Apart {
        fn rank(&self) -> usize {
            0
        }

        fn size(&self) -> usize {
            2
        }

        fn exchange(&self, own: Result<Vec<u8>, Error>) -> Result<Vec<Vec<u8>>, Error> {
            Ok(vec![own?, b"another listing".to_vec()])
        }
    }

    #[test]
    fn ranks_that_do_not_see_the_same_phrases_are_refused() {
        let (_folder, config) = dataset(3);
        let opened = Dataset::<PhraseItem>::open_among(&config, &no_progress, &Apart);
        let error = opened.unwrap_err();
        assert!(matches!(error, Error::OtherListing { .. }), "{error}");
        let expected = "rank 1 finds other phrases there than rank 0";
        assert!(error.to_string().contains(expected), "{error}");
    }

    #[test]
    fn missing_and_cut_off_files_are_bad_phrases() {
        let (folder, config) = dataset(3);
        let features = folder.path().join(features_path("synthetic_00001"));
        let bytes = fs::read(&features).unwrap();
        fs::write(&features, &bytes[..bytes.len() / 2]).unwrap();
        let message = Dataset::<PhraseItem>::open(&config)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("`synthetic_00001`") && message.contains("features.npz"),
            "{message}"
        );
        fs::remove_file(folder.path().join(motion_path("synthetic_00000"))).unwrap();
        let message = Dataset::<PhraseItem>::open(&config)
            .unwrap_err()
            .to_string();
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
        let read = Dataset::<PhraseItem>::open(&config).unwrap();
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
        let digest = |config: &DataConfig| Dataset::<PhraseItem>::open(config).unwrap().digest;
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
    fn missing_and_empty_datasets_are_distinguished() {
        let folder = tempfile::tempdir().unwrap();
        let open = |path: &Path| {
            let source = Some(path.display().to_string());
            Dataset::<PhraseItem>::open(&DataConfig {
                source,
                ..DataConfig::default()
            })
            .unwrap_err()
        };
        let missing = open(&folder.path().join("nowhere"));
        assert!(matches!(missing, Error::MissingFolder(_)), "{missing}");
        fs::create_dir_all(folder.path().join("motion/a")).unwrap();
        let half = open(folder.path()).to_string();
        assert!(half.contains("audio_features not found"), "{half}");
        fs::create_dir_all(folder.path().join("audio_features/b")).unwrap();
        let empty = open(folder.path());
        assert!(matches!(empty, Error::NothingToTrainOn { .. }), "{empty}");
        let expected = "1 only in motion/, 1 only in audio_features/";
        assert!(empty.to_string().contains(expected), "{empty}");
    }

    #[test]
    fn unpaired_folders_are_warned_of_and_the_limit_takes_the_first_ids() {
        let (folder, mut config) = dataset(5);
        fs::create_dir_all(folder.path().join("motion/zz")).unwrap();
        config.num_phrases = Some(2);
        config.validation.fraction = Some(0.0);
        let read = Dataset::<PhraseItem>::open(&config).unwrap();
        assert_eq!(ids(&read.train), ["synthetic_00000", "synthetic_00001"]);
        assert!(read.warnings[0].contains("zz"), "{:?}", read.warnings);
    }
}
