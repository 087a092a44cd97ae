//! Plans: which motion belongs to which music, and how phrases are cut; or which captures become
//! clips.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use kinegrad_data::file::read_text;
use kinegrad_data::{
    AudioGroup, AudioLayout, MAX_FRAMES, MIN_FRAMES, StoreConfig, check_groups, check_id, is_label,
};
use kinegrad_settings::{ABOVE_ZERO, Document, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Table;

use super::grid::Grid;
use super::units::Units;
use crate::bodies::{CaptionsPlan, CapturePlan, ClipsPlan};
use crate::error::PLANS;
use crate::{BeatGrid, Beats, Error, Joining, MarkerMap, UpAxis};

/// Metres of the smallest unit of a plan.
pub(crate) const SMALLEST_UNIT: f64 = 1e-9;

/// The smallest frame rate of a plan.
pub(crate) const LEAST_FPS: f64 = 0.1;

/// The largest number of seconds, metres or frames per second of a plan.
const MOST: f64 = 1e5;

/// The keys of plans of phrases and of plans of clips.
const OF_PHRASES: [&str; 4] = ["phrases", "joining", "take", "choreonet"];
const OF_CLIPS: [&str; 3] = ["clips", "captions", "capture"];

/// A plan, as its TOML file writes it: of phrases, with `[[take]]` or `[[choreonet]]`, or of clips,
/// with `[[capture]]`. Paths are relative to that file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Where the dataset goes: a folder, `gs://BUCKET/PREFIX` or `s3://BUCKET/PREFIX`.
    pub output: String,
    /// How phrases are cut.
    #[serde(default)]
    pub phrases: PhrasesPlan,
    /// How clips are made of captures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clips: Option<ClipsPlan>,
    /// What is held out.
    #[serde(default)]
    pub split: SplitPlan,
    /// Captions of clips that are made of their labels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captions: Option<CaptionsPlan>,
    /// How a bucket is spoken to.
    #[serde(default)]
    pub store: StoreConfig,
    /// How pieces captured apart are joined.
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

/// How phrases are cut.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhrasesPlan {
    /// Frames of a phrase, 30 a second.
    pub frames: usize,
    /// Frames from the beginning of one phrase to the next.
    pub hop: usize,
    /// Groups of audio features that are stored: `["document"]`, or `["document", "beats"]` with
    /// position in beat and bar, beat marks and local tempo.
    pub audio_features: Vec<AudioGroup>,
}

impl Default for PhrasesPlan {
    fn default() -> Self {
        Self {
            frames: 120,
            hop: 120,
            audio_features: AudioLayout::DOCUMENT.groups(),
        }
    }
}

/// What is held out.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SplitPlan {
    /// Ids of phrases, or names of takes that become clips, or patterns with `*` for any run of
    /// characters: `"C_5_*"` is a whole take. Without any, `fraction` decides.
    pub validation: Vec<String>,
    /// Share that is held out where nothing is named. Of phrases, of the songs: those whose names
    /// have the lowest hashes, at least one of several and never all. Of clips, of the takes with the
    /// same labels: the last by their numbers, rounded, never all, and windows of one file together.
    /// With 0, none is.
    pub fraction: f64,
    /// Names of takes, or patterns, whose clips are held out for the end.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub test: Vec<String>,
    /// Share of the takes with the same labels whose clips are held out for the end, where `test`
    /// names none: the very last ones, after those of `fraction`; none unless stated.
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

/// A recording with its music.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TakePlan {
    /// Begins the ids of its phrases; `{name}` stands for the motion file's name without ending,
    /// which is also the default.
    pub name: Option<String>,
    /// A capture file (.bvh, .c3d, .npy, .npz); `*` in its name takes every file that matches.
    pub motion: Option<String>,
    /// Pieces of capture files on the beats of the music, instead of `motion`.
    #[serde(default, rename = "segment")]
    pub segments: Vec<SegmentPlan>,
    /// Seconds into the motion file at which to begin.
    #[serde(default)]
    pub motion_start_seconds: f64,
    /// Seconds into the motion file at which to end.
    pub motion_end_seconds: Option<f64>,
    /// A song (.mp3, .wav, .flac, .ogg), or `none`; `{name}` stands for the motion file's name,
    /// `*` for any ending.
    pub audio: String,
    /// Seconds into the song at which the motion begins.
    #[serde(default)]
    pub audio_start_seconds: f64,
    /// The beats, if they are known; else they are tracked.
    pub beats: Option<BeatGrid>,
    /// Beats in a bar of tracked beats; four unless stated.
    pub beats_per_bar: Option<u32>,
    /// Seconds into the song of a downbeat, where the beats are tracked: the tracked beat nearest
    /// to it begins a bar. Without it the first does, and beat features do not tell the bar.
    pub downbeat_seconds: Option<f64>,
    /// Which beats segments lie on; unless stated, those tracked in the song where they are as many
    /// as `beats` states, within 2 %, else even ones.
    pub grid: Option<Grid>,
    /// Metres of one unit of a BVH file, or its name; centimetres unless stated.
    pub units: Option<Units>,
    /// The axis of a BVH file that points up; y unless stated.
    pub up: Option<UpAxis>,
    /// The joint of a BVH file that is the root; by default the first.
    pub joint: Option<String>,
    /// The markers of a C3D file that carry the root; those of Plug-in Gait's waist unless stated.
    pub markers: Option<MarkerMap>,
    /// Frames per second of arrays, which do not state it; 30 unless stated.
    pub fps: Option<f64>,
    /// What is danced, such as `waltz`: what models with `model.style` can be asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
}

/// A piece of a capture file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SegmentPlan {
    /// The capture file. A missing one is a gap.
    pub motion: String,
    /// First and last frame in the file, counted from 0, with fractions.
    pub frames: [f64; 2],
    /// Its length in beats. Segments follow each other from the first beat on.
    pub beats: f64,
}

/// Dances of the ChoreoNet data: units of capture on the beats of songs.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChoreonetPlan {
    /// JSON list of dances: `dance_type`, `dance_id`, `start_pos` and `end_pos` at 25 frames per
    /// second, `movements`, `durations` in beats.
    pub choreography: String,
    /// CSV with `c3d_file`, `movement_tag`, `start_frame`, `end_frame`.
    pub intervals: String,
    /// Folder of the capture files, `NAME.c3d`.
    pub captures: String,
    /// A song; `{type}` and `{id}` stand for the dance's.
    pub music: String,
    /// Dance types whose bars have three beats.
    #[serde(default = "waltz")]
    pub three_beats_per_bar: Vec<String>,
    /// The markers that carry the root.
    #[serde(default)]
    pub markers: MarkerMap,
    /// Which beats units lie on; see `take.grid`.
    pub grid: Option<Grid>,
    /// What is danced, by dance type, for example `{ W = "waltz" }`: labels of the phrases, see
    /// `take.label`.
    #[serde(default)]
    pub labels: BTreeMap<String, String>,
}

fn waltz() -> Vec<String> {
    vec!["W".to_owned()]
}

impl Plan {
    /// Reads the plan at `path` and checks what can be checked without opening another file.
    ///
    /// # Errors
    /// [`Error::Plan`] with the line or key, what was found and what is allowed.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_text(path).map_err(|problem| Error::plan(path, problem))?;
        let file = path.display().to_string();
        let document = Document::parse(&text, &file)?;
        let mut plan: Self = document.read(PLANS)?;
        plan.folder = path.parent().unwrap_or(Path::new("")).to_owned();
        one_kind(&document.table).map_err(|problem| Error::plan(path, problem))?;
        let checked = plan.check().hint(PLANS);
        checked.map_err(|setting| document.refuse(setting))?;
        if !plan.is_of_clips() && plan.takes.is_empty() && plan.choreonet.is_empty() {
            let problem = "no [[take]], [[choreonet]] or [[capture]]: nothing to prepare";
            return Err(Error::plan(path, problem));
        }
        Ok(plan)
    }

    /// Whether it is a plan of clips, and not of phrases.
    pub fn is_of_clips(&self) -> bool {
        !self.captures.is_empty()
    }

    /// How clips are made.
    pub(crate) fn clips(&self) -> ClipsPlan {
        self.clips.clone().unwrap_or_default()
    }

    /// Captions that are made of labels.
    pub(crate) fn captions(&self) -> CaptionsPlan {
        self.captions.clone().unwrap_or_default()
    }

    fn check(&self) -> Result<(), InvalidSetting> {
        in_range(
            "phrases.frames",
            self.phrases.frames,
            MIN_FRAMES..=MAX_FRAMES,
        )?;
        in_range("phrases.hop", self.phrases.hop, 1..)?;
        check_groups("phrases.audio_features", &self.phrases.audio_features)?;
        in_range("split.fraction", self.split.fraction, 0.0..1.0)?;
        let test = self.split.test_fraction;
        in_range("split.test_fraction", test.unwrap_or_default(), 0.0..1.0)?;
        if self.is_of_clips() {
            self.clips().check()?;
            self.captions().check()?;
            let mut captures = self.captures.iter().enumerate();
            return captures.try_for_each(|(index, capture)| {
                capture.check().within(&format!("capture[{index}]"))
            });
        }
        for (key, given) in [
            ("split.test", !self.split.test.is_empty()),
            ("split.test_fraction", test.is_some()),
        ] {
            require(
                !given,
                key,
                "given",
                "in plans of clips, which have [[capture]]",
            )?;
        }
        self.joining.check().within("joining")?;
        let mut takes = self.takes.iter().enumerate();
        takes.try_for_each(|(index, take)| take.check().within(&format!("take[{index}]")))
    }

    /// `path` from where the plan stands.
    pub fn resolve(&self, path: &str) -> PathBuf {
        self.folder.join(path)
    }
}

/// Rejects a plan that has keys of phrases and of clips.
fn one_kind(given: &Table) -> Result<(), String> {
    let first = |keys: &[&'static str]| keys.iter().copied().find(|key| given.contains_key(*key));
    match (first(&OF_PHRASES), first(&OF_CLIPS)) {
        (Some(phrases), Some(clips)) => Err(format!(
            "`{phrases}` is for phrases and `{clips}` for clips: a plan makes one of them, so write \
             two plans"
        )),
        _ => Ok(()),
    }
}

/// Rejects numbers of seconds, metres or hertz that no recording has.
pub(crate) fn check_number(
    key: &str,
    number: Option<f64>,
    least: f64,
) -> Result<(), InvalidSetting> {
    number.map_or(Ok(()), |number| in_range(key, number, least..=MOST))
}

/// Rejects an end of a part of a motion file that is not behind its beginning.
pub(crate) fn check_end(start: f64, end: Option<f64>) -> Result<(), InvalidSetting> {
    check_number("motion_start_seconds", Some(start), 0.0)?;
    let after = end.is_none_or(|end| end > start && end.is_finite());
    let found = end.unwrap_or_default();
    let allowed = "a moment after `motion_start_seconds`";
    require(after, "motion_end_seconds", found, allowed)
}

/// Rejects a name that cannot begin ids.
pub(crate) fn check_name(name: Option<&str>) -> Result<(), InvalidSetting> {
    let name = name.unwrap_or("x");
    check_id(&name.replace("{name}", "x"))
        .map_err(|error| InvalidSetting::new("name", format!("\"{name}\""), error))
}

impl TakePlan {
    /// Checks what can be checked without opening a file.
    ///
    /// # Errors
    /// Names the key.
    pub(super) fn check(&self) -> Result<(), InvalidSetting> {
        let label = self.label.as_deref().unwrap_or("x");
        let found = format!("\"{label}\"");
        let allowed = "a word that is no number and has no comma";
        require(is_label(label), "label", found, allowed)?;
        let pieces = !self.segments.is_empty();
        let allowed = "either `motion` or [[take.segment]]";
        let found = if pieces {
            "given with segments"
        } else {
            "missing"
        };
        require(self.motion.is_some() != pieces, "motion", found, allowed)?;
        if pieces {
            let allowed = "the beats that segments lie on";
            require(self.beats.is_some(), "beats", "missing", allowed)?;
            let allowed = "the name of a take of segments";
            require(self.name.is_some(), "name", "missing", allowed)?;
        }
        check_name(self.name.as_deref())?;
        check_end(self.motion_start_seconds, self.motion_end_seconds)?;
        check_number("audio_start_seconds", Some(self.audio_start_seconds), 0.0)?;
        check_number("downbeat_seconds", self.downbeat_seconds, -MOST)?;
        check_number("units", self.units.map(Units::metres), SMALLEST_UNIT)?;
        check_number("fps", self.fps, LEAST_FPS)?;
        if let Some(grid) = &self.beats {
            let seconds_per_beat = grid.seconds_per_beat;
            in_range("beats.seconds_per_beat", seconds_per_beat, 0.01..=60.0)?;
            in_range("beats.start_seconds", grid.start_seconds, -MOST..=MOST)?;
            Beats::Grid(*grid).check().within("beats")?;
        }
        let whole = "in whole takes; segments have `frames` and follow `beats`";
        let tracked = "where beats are tracked; `beats` states bars of its own";
        for (key, given, holds, allowed) in [
            (
                "beats_per_bar",
                self.beats_per_bar.is_some(),
                self.beats.is_none(),
                tracked,
            ),
            (
                "downbeat_seconds",
                self.downbeat_seconds.is_some(),
                self.beats.is_none(),
                tracked,
            ),
            (
                "motion_start_seconds",
                self.motion_start_seconds != 0.0,
                !pieces,
                whole,
            ),
            (
                "motion_end_seconds",
                self.motion_end_seconds.is_some(),
                !pieces,
                whole,
            ),
            (
                "audio_start_seconds",
                self.audio_start_seconds != 0.0,
                !pieces,
                whole,
            ),
            (
                "grid",
                self.grid.is_some(),
                pieces,
                "for segments; a whole take is not moved",
            ),
        ] {
            require(!given || holds, key, "given", allowed)?;
        }
        in_range(
            "beats_per_bar",
            u64::from(self.beats_per_bar.unwrap_or(1)),
            1..,
        )?;
        for (index, segment) in self.segments.iter().enumerate() {
            let [from, to] = segment.frames;
            let ordered = from.is_finite() && to.is_finite() && 0.0 <= from && from < to;
            let key = format!("segment[{index}].frames");
            let found = format!("[{from}, {to}]");
            require(ordered, key, found, "two increasing frames, 0 or more")?;
            in_range(format!("segment[{index}].beats"), segment.beats, ABOVE_ZERO)?;
        }
        Ok(())
    }

    /// Rejects keys that none of the take's capture files uses.
    pub(super) fn check_kinds(&self, files: &[&Path]) -> Result<(), String> {
        let keys = [
            ("units", self.units.is_some(), &["bvh"][..]),
            ("up", self.up.is_some(), &["bvh"]),
            ("joint", self.joint.is_some(), &["bvh"]),
            ("markers", self.markers.is_some(), &["c3d"]),
            ("fps", self.fps.is_some(), &["npy", "npz"]),
        ];
        let endings = files.iter().filter_map(|file| file.extension());
        let endings: Vec<OsString> = endings.map(|e| e.to_ascii_lowercase()).collect();
        let has = |kinds: &[&str]| endings.iter().any(|e| kinds.iter().any(|kind| e == kind));
        match keys.iter().find(|(_, given, kinds)| *given && !has(kinds)) {
            Some((key, _, kinds)) => Err(format!(
                "`{key}` is for .{} files, and this take has none",
                kinds.join(" and .")
            )),
            None => Ok(()),
        }
    }
}
