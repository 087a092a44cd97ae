//! A dataset of clips: every clip read once, checked and put on its side of the split.

use std::sync::Arc;

use kinegrad_motion::humanml::{FeatureLayout, FeatureStatistics, Skeleton};

use crate::files::Files;
use crate::library::Entry;
use crate::listing::{Expected, Listed};
use crate::split::{Side, Split};
use crate::store::Store;
use crate::survey::{OpenProgress, Survey};
use crate::{Counters, DataConfig, DataKind, Digest, Error, LoaderReport, StoreError};

use super::clip::ClipFiles;
use super::embeddings::{self, Embeddings};
use super::lists::read_lists;
use super::synthetic::Walks;
use super::{CaptionRule, Clip, ClipSet, statistics, synthetic_id};

/// The clips of a dataset, sorted by id within each side of the split.
#[derive(Clone, Debug)]
pub struct ClipDataset {
    /// Clips to train on; at least one.
    pub train: ClipSet,
    /// Clips held out; may be none.
    pub validation: ClipSet,
    /// Mean and deviation of each channel of features whose root is `data.humanml3d.root`: the
    /// dataset's own, or those of the training clips.
    pub statistics: FeatureStatistics,
    /// Whose joints the features are of.
    pub skeleton: Skeleton,
    /// Whether there are embeddings of the captions.
    pub conditional: bool,
    /// Id and reason of each bad clip left out under `on_bad_phrase = "skip"`.
    pub skipped: Vec<(String, String)>,
    /// Id and reason of each clip that is too short, too long, or has captions of short passages
    /// only.
    pub left_out: Vec<(String, String)>,
    /// What a user should hear of without the run being stopped.
    pub warnings: Vec<String>,
    /// A checksum of the ids, files and side of the split of all clips used, and of the files of
    /// embeddings and statistics. Equal datasets have equal ones, wherever they lie.
    pub digest: Digest,
    counters: Arc<Counters>,
}

/// A dataset of clips that are known by name.
pub(super) struct ClipSurvey {
    pub survey: Survey<Clip>,
    pub skeleton: Skeleton,
    /// The statistics that the dataset brings along.
    pub given: Option<FeatureStatistics>,
    pub conditional: bool,
    /// What decides on made-up clips; of files their lists do.
    split: Option<Split>,
}

impl ClipSurvey {
    /// Lists the clips of a valid `config`.
    ///
    /// # Errors
    /// As [`ClipDataset::open`], but for those of single clips and of the split.
    pub fn new(config: &DataConfig) -> Result<Self, Error> {
        match config.kind {
            DataKind::Humanml3d => Self::of_files(config),
            DataKind::SyntheticWalks => Self::made_up(config),
            kind @ (DataKind::Phrases | DataKind::Synthetic) => Err(Error::wrong_kind(
                kind,
                "\"humanml3d\" or \"synthetic_walks\"",
                "phrases of motion and music are no clips: another recipe or command takes them",
            )),
        }
    }

    fn made_up(config: &DataConfig) -> Result<Self, Error> {
        let conditional = !config.humanml3d.text_embeddings.is_empty();
        let split = Split::new(&config.validation)?;
        let mut listed = Listed::made_up(config.synthetic.phrases, synthetic_id);
        listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
        let ids: Vec<&str> = listed.iter().map(|item| item.id.as_str()).collect();
        Ok(Self {
            skeleton: config.humanml3d.skeleton.skeleton(),
            given: None,
            conditional,
            survey: Survey {
                warnings: split.idle_entries(&ids),
                origin: Box::new(Walks::new(config, conditional)),
                counters: Arc::default(),
                source: "synthetic_walks".to_owned(),
                listed,
                concurrency: 0,
                tolerates_changes: false,
            },
            split: Some(split),
        })
    }

    fn of_files(config: &DataConfig) -> Result<Self, Error> {
        let humanml3d = &config.humanml3d;
        let mut warnings = Vec::new();
        let source = config.source.as_deref().unwrap_or_default();
        let store = Store::open(source, &config.store)?;
        let files = Files::open(store, config, &mut warnings)?;
        let mut listed = read_lists(&files, humanml3d, &mut warnings)?;
        listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
        let skeleton = humanml3d.skeleton.skeleton();
        let given = statistics::given(&files, humanml3d.root, &skeleton)?;
        let embeddings = read_embeddings(&files, &humanml3d.text_embeddings, &mut warnings)?;
        let conditional = embeddings.is_some();
        let fingerprint = given.as_ref().map(|given| {
            let [mean, std] = given.digests;
            format!("{mean}{std}")
        });
        Ok(Self {
            conditional,
            split: None,
            survey: Survey {
                warnings,
                counters: files.store.counters().clone(),
                source: files.store.uri(),
                listed,
                concurrency: files.concurrency(config),
                tolerates_changes: false,
                origin: Box::new(ClipFiles {
                    files,
                    skeleton: skeleton.clone(),
                    embeddings,
                    captions_required: match humanml3d.captions {
                        Some(rule) => rule == CaptionRule::Required,
                        None => conditional,
                    },
                    min_frames: humanml3d.min_frames,
                    max_frames: humanml3d.max_frames,
                    fingerprint: fingerprint.unwrap_or_default(),
                }),
            },
            skeleton,
            given: given.map(|given| given.statistics),
        })
    }

    /// Whether the clip `id`, which a list puts on the side `stated`, is held out.
    pub fn holds_out(&self, id: &str, stated: Option<Side>) -> bool {
        holds_out(self.split.as_ref(), id, stated)
    }
}

/// The rule of the config decides, where there is one, else the list that the clip is on.
fn holds_out(split: Option<&Split>, id: &str, stated: Option<Side>) -> bool {
    match split {
        Some(split) => split.holds_out(id, stated),
        None => stated == Some(Side::Validation),
    }
}

fn read_embeddings(
    files: &Files,
    path: &str,
    warnings: &mut Vec<String>,
) -> Result<Option<Embeddings>, Error> {
    if path.is_empty() {
        return Ok(None);
    }
    let unknown = Expected::Version(String::new());
    match files.read(path, &unknown, embeddings::MAX_BYTES, "") {
        Ok((bytes, digest)) => {
            let name = files.store.name_of(path);
            Ok(Some(Embeddings::parse(&bytes, &name, digest)?))
        }
        Err(StoreError::Missing { object }) => {
            warnings.push(format!(
                "{object}: not found; clips have no condition (docs/dataset.md shows how to make \
                 the file; data.humanml3d.text_embeddings = \"\" says that none is wanted)"
            ));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

impl ClipDataset {
    /// Opens the dataset that `config` describes, reading all clips in parallel.
    ///
    /// # Errors
    /// [`Error::Config`] for settings that cannot be followed, a `kind` of phrases among them;
    /// [`Error::Scheme`] and [`Error::Feature`]; [`Error::File`] for a list, statistics or
    /// embeddings that cannot be used; [`Error::Store`], [`Error::Io`] for a dataset that cannot
    /// be reached; [`Error::BadItem`] for the first bad clip by id, or [`Error::AllSkipped`];
    /// [`Error::NoClipOfLength`] where every clip is left out; [`Error::EmptyTrainSplit`].
    pub fn open(config: &DataConfig) -> Result<Self, Error> {
        Self::open_with_progress(config, &|_, _| {})
    }

    /// [`open`](Self::open), telling `progress` how far it is.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with_progress(config: &DataConfig, progress: OpenProgress) -> Result<Self, Error> {
        config.validate()?;
        let ClipSurvey {
            mut survey,
            skeleton,
            given,
            conditional,
            split,
        } = ClipSurvey::new(config)?;
        let mut warnings = std::mem::take(&mut survey.warnings);
        let mut gathered = survey.gather(config, progress)?;
        let left_out = std::mem::take(&mut gathered.left_out);
        if let (true, Some((id, reason))) = (gathered.entries.is_empty(), left_out.first()) {
            return Err(Error::NoClipOfLength {
                clips: left_out.len(),
                first: format!("clip `{id}`: {reason}"),
            });
        }
        if let Some((id, note)) = gathered.notes.first() {
            let count = gathered.notes.len();
            warnings.push(format!(
                "captions of {count} clip(s) are left out; the first: clip `{id}`: {note}"
            ));
        }
        let skipped = std::mem::take(&mut gathered.skipped);
        let counters = survey.counters.clone();
        let sides = survey.split(gathered, |entry: &Entry| {
            holds_out(split.as_ref(), &entry.id, entry.side)
        })?;
        let statistics = match given {
            Some(given) => given,
            None => sides.train.statistics(config.humanml3d.root)?,
        };
        Ok(Self {
            train: sides.train,
            validation: sides.validation,
            statistics,
            skeleton,
            conditional,
            skipped,
            left_out,
            warnings,
            digest: sides.digest,
            counters,
        })
    }

    /// Which channel of the features says what.
    pub fn layout(&self) -> FeatureLayout {
        self.skeleton.layout()
    }

    /// Reads the clip `id`, from either side of the split; `None` if there is none.
    ///
    /// # Errors
    /// As [`ClipSet::get`].
    pub fn find(&self, id: &str) -> Result<Option<Arc<Clip>>, Error> {
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
#[path = "dataset_tests.rs"]
mod tests;
