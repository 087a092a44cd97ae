//! Plans of `kinegrad data prepare`: the recordings of a dataset of phrases or of clips.

mod clips;
mod limits;
mod pattern;
mod phrases;
mod units;

use std::path::{Path, PathBuf};

use kinegrad_data::file::read_text;
use kinegrad_data::{MAX_FRAMES, MIN_FRAMES, StoreConfig, check_groups};
use kinegrad_settings::{Document, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(crate) use clips::check_label;
pub use clips::{CaptionsPlan, CapturePlan, ClipsPlan, LabelsPlan, Names, Wordings};
pub(crate) use pattern::{Part, TAKE, parts};
pub use phrases::{ChoreonetPlan, Grid, PhrasesPlan, SegmentPlan, TakePlan};
pub use units::Units;

use crate::error::PLANS;
use crate::{Error, Joining};

/// The keys of plans of phrases and of plans of clips.
const OF_PHRASES: [&str; 4] = ["phrases", "joining", "take", "choreonet"];
const OF_CLIPS: [&str; 3] = ["clips", "captions", "capture"];

/// A plan from a TOML file: a plan of phrases, with `[[take]]` or `[[choreonet]]`, or a plan of
/// clips, with `[[capture]]`. Paths are relative to that file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Destination of the dataset: a folder, `gs://BUCKET/PREFIX` or `s3://BUCKET/PREFIX`.
    pub output: String,
    /// Length of phrases and their audio features.
    #[serde(default)]
    pub phrases: PhrasesPlan,
    /// Length of clips, frame rate and bones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clips: Option<ClipsPlan>,
    /// Held-out phrases or takes.
    #[serde(default)]
    pub split: SplitPlan,
    /// Captions made from labels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captions: Option<CaptionsPlan>,
    /// Settings of the connection to a bucket.
    #[serde(default)]
    pub store: StoreConfig,
    /// Joins between segments of different captures.
    #[serde(default)]
    pub joining: Joining,
    /// Recordings, each with its music.
    #[serde(default, rename = "take")]
    pub takes: Vec<TakePlan>,
    /// Choreographies of the ChoreoNet data.
    #[serde(default)]
    pub choreonet: Vec<ChoreonetPlan>,
    /// Full-body captures, which become clips.
    #[serde(default, rename = "capture")]
    pub captures: Vec<CapturePlan>,
    /// The folder that paths are relative to.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// Held-out phrases or takes.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SplitPlan {
    /// Validation set: ids of phrases, names of takes that become clips, or patterns in which `*`
    /// stands for any characters: `"C_5_*"` is a whole take. If empty, `fraction` decides.
    pub validation: Vec<String>,
    /// Fraction that is held out for validation if `validation` is empty; 0 for none. For phrases,
    /// this is a fraction of the songs: the songs whose names have the lowest hashes, at least one
    /// of several and never all. For clips, this is a fraction of the takes with the same labels:
    /// the last takes by number, never all. Takes of one file stay together.
    pub fraction: f64,
    /// Test set: names of takes, or patterns, whose clips are held out for the end.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub test: Vec<String>,
    /// Fraction of the takes with the same labels that is the test set if `test` is empty: the last
    /// takes by number, after those of `fraction`. By default the test set is empty.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub test_fraction: Option<f64>,
}

impl Default for SplitPlan {
    fn default() -> Self {
        Self {
            validation: Vec::new(),
            fraction: 0.1,
            test: Vec::new(),
            test_fraction: None,
        }
    }
}

impl Plan {
    /// Reads the plan at `path` and checks it without opening another file.
    ///
    /// # Errors
    /// [`Error::Plan`] or [`Error::Document`] with the line or key.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_text(path).map_err(|problem| Error::plan(path, problem))?;
        Self::parse(&text, path)
    }

    /// [`read`](Self::read) of the `text` at `path`, without opening any file.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        let file = path.display().to_string();
        let parsed = Document::parse(text, &file)?;
        let mut plan: Self = parsed.read(PLANS)?;
        plan.folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let has = |key: &&&str| parsed.table.contains_key(**key);
        let (phrases, clips) = (OF_PHRASES.iter().find(has), OF_CLIPS.iter().find(has));
        if let (Some(phrases), Some(clips)) = (phrases, clips) {
            let problem = format!(
                "`{phrases}` is for phrases and `{clips}` for clips: a plan makes one of them, so \
                 write two plans"
            );
            return Err(Error::plan(path, problem));
        }
        let checked = plan.check().hint(PLANS);
        checked.map_err(|setting| parsed.refuse(setting))?;
        if !plan.is_of_clips() && plan.takes.is_empty() && plan.choreonet.is_empty() {
            let problem = "no [[take]], [[choreonet]] or [[capture]]: nothing to prepare";
            return Err(Error::plan(path, problem));
        }
        Ok(plan)
    }

    /// True for a plan of clips, false for a plan of phrases.
    pub fn is_of_clips(&self) -> bool {
        !self.captures.is_empty()
    }

    /// The table `clips`.
    pub(crate) fn clips(&self) -> ClipsPlan {
        self.clips.clone().unwrap_or_default()
    }

    /// The table `captions`.
    pub(crate) fn captions(&self) -> CaptionsPlan {
        self.captions.clone().unwrap_or_default()
    }

    fn check(&self) -> Result<(), InvalidSetting> {
        let lengths = MIN_FRAMES..=MAX_FRAMES;
        in_range("phrases.frames", self.phrases.frames, lengths)?;
        in_range("phrases.hop", self.phrases.hop, 1..)?;
        check_groups("phrases.audio_features", &self.phrases.audio_features)?;
        in_range("split.fraction", self.split.fraction, 0.0..1.0)?;
        let test = self.split.test_fraction;
        in_range("split.test_fraction", test.unwrap_or_default(), 0.0..1.0)?;
        if self.is_of_clips() {
            self.clips().check()?;
            self.captions().check()?;
            for (index, capture) in self.captures.iter().enumerate() {
                capture.check().within(&format!("capture[{index}]"))?;
            }
            return Ok(());
        }
        let allowed = "in plans of clips, which have [[capture]]";
        require(self.split.test.is_empty(), "split.test", "given", allowed)?;
        require(test.is_none(), "split.test_fraction", "given", allowed)?;
        self.joining.check().within("joining")?;
        let mut takes = self.takes.iter().enumerate();
        takes.try_for_each(|(index, take)| take.check().within(&format!("take[{index}]")))
    }

    /// A path of the plan, relative to the plan's folder.
    pub fn resolve(&self, path: &str) -> PathBuf {
        self.folder.join(path)
    }
}
