//! Plans: which motion belongs to which music, and how phrases are cut; or which captures become
//! clips.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use kinegrad_data::file::read_text;
use kinegrad_data::{
    AudioGroup, AudioLayout, MAX_FRAMES, MIN_FRAMES, StoreConfig, check_groups, check_id, is_label,
};
use kinegrad_settings::{in_words, must_be_finite, must_be_tables};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Table;

use super::grid::Grid;
use super::units::Units;
use crate::bodies::{CaptionsPlan, CapturePlan, ClipsPlan};
use crate::{BeatGrid, Beats, Error, Joining, MarkerMap, UpAxis};

/// Metres of the smallest unit that makes sense.
const SMALLEST_UNIT: f64 = 1e-9;

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

/// What is wrong with a file's `text`, and in which line.
pub(crate) fn with_line(text: &str, error: &toml::de::Error) -> String {
    let place = error.span().map(|span| {
        let before = &text.as_bytes()[..span.start.min(text.len())];
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        format!("line {line}: ")
    });
    let place = place.unwrap_or_default();
    format!("{place}{}", in_words(error.message()))
}

impl Plan {
    /// Reads the plan at `path` and checks what can be checked without opening another file.
    ///
    /// # Errors
    /// [`Error::Plan`] with the line or key, what was found and what is allowed.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_text(path).map_err(|problem| Error::plan(path, problem))?;
        let wrong = |error: toml::de::Error| Error::plan(path, with_line(&text, &error));
        let given: Table = text.parse().map_err(wrong)?;
        let mut plan: Self = toml::from_str(&text).map_err(wrong)?;
        let read = Table::try_from(&plan).expect("a plan is plain data");
        must_be_finite(&given)
            .and_then(|()| must_be_tables(&given, &read))
            .map_err(|unfit| Error::plan(path, unfit))?;
        plan.folder = path.parent().unwrap_or(Path::new("")).to_owned();
        one_kind(&given)
            .and_then(|()| plan.check())
            .map_err(|problem| Error::plan(path, problem))?;
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

    fn check_clips(&self) -> Result<(), String> {
        self.clips().check()?;
        self.captions().check()?;
        for capture in &self.captures {
            let sound = capture.check();
            sound.map_err(|problem| format!("capture `{}`: {problem}", capture.motion))?;
        }
        Ok(())
    }

    fn check(&self) -> Result<(), String> {
        let frames = self.phrases.frames;
        if !(MIN_FRAMES..=MAX_FRAMES).contains(&frames) {
            return Err(format!(
                "phrases.frames = {frames}: {MIN_FRAMES} to {MAX_FRAMES} allowed"
            ));
        }
        if self.phrases.hop == 0 {
            return Err("phrases.hop = 0: at least 1 allowed".to_owned());
        }
        check_groups("phrases.audio_features", &self.phrases.audio_features)
            .map_err(|refused| refused.to_string())?;
        let fraction = self.split.fraction;
        if !(0.0..1.0).contains(&fraction) {
            return Err(format!(
                "split.fraction = {fraction}: from 0 to below 1 allowed"
            ));
        }
        let test = self.split.test_fraction.unwrap_or_default();
        if !(0.0..1.0).contains(&test) {
            return Err(format!(
                "split.test_fraction = {test}: from 0 to below 1 allowed"
            ));
        }
        if self.is_of_clips() {
            return self.check_clips();
        }
        if !self.split.test.is_empty() || self.split.test_fraction.is_some() {
            return Err(
                "split.test and split.test_fraction are for clips, and this plan has no [[capture]]"
                    .to_owned(),
            );
        }
        let joining = self.joining.check();
        joining.map_err(|error| format!("joining: {}", error.with_hint()))?;
        if self.takes.is_empty() && self.choreonet.is_empty() {
            return Err("no [[take]], [[choreonet]] or [[capture]]: nothing to prepare".to_owned());
        }
        for (index, take) in self.takes.iter().enumerate() {
            let named = take.name.as_deref().or(take.motion.as_deref());
            let label = named.map_or(format!("take {index}"), |name| format!("take `{name}`"));
            let sound = take.check();
            sound.map_err(|problem| format!("{label}: {problem}"))?;
        }
        Ok(())
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

impl TakePlan {
    /// In an error, the key and what is wrong with it.
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(label) = &self.label
            && !is_label(label)
        {
            return Err(format!(
                "label = \"{label}\": a word that is no number and has no comma allowed"
            ));
        }
        match (&self.motion, self.segments.is_empty()) {
            (Some(_), true) => {}
            (None, false) if self.beats.is_none() => {
                return Err("segments lie on beats: `beats` is missing".to_owned());
            }
            (None, false) if self.name.is_none() => {
                return Err("a take of segments needs a `name`".to_owned());
            }
            (None, false) => {}
            _ => return Err("either `motion` or [[take.segment]] allowed, not both".to_owned()),
        }
        if let Some(name) = &self.name {
            check_id(&name.replace("{name}", "x")).map_err(|error| error.to_string())?;
        }
        for (key, value, least) in [
            ("motion_start_seconds", Some(self.motion_start_seconds), 0.0),
            ("audio_start_seconds", Some(self.audio_start_seconds), 0.0),
            ("downbeat_seconds", self.downbeat_seconds, -1e5),
            ("units", self.units.map(Units::metres), SMALLEST_UNIT),
            ("fps", self.fps, 0.1),
        ] {
            if let Some(value) = value
                && !(least..=1e5).contains(&value)
            {
                return Err(format!("{key} = {value}: a number from {least} allowed"));
            }
        }
        // Not a number comes after nothing.
        let after = |end: f64| end > self.motion_start_seconds && end.is_finite();
        if !self.motion_end_seconds.is_none_or(after) {
            return Err("motion_end_seconds must come after motion_start_seconds".to_owned());
        }
        if let Some(grid) = &self.beats {
            let (beat, start) = (grid.seconds_per_beat, grid.start_seconds);
            if !(0.01..=60.0).contains(&beat) || !(-1e5..=1e5).contains(&start) {
                return Err(format!(
                    "beats: seconds_per_beat = {beat}, start_seconds = {start} found; 0.01 to 60 \
                     and -100000 to 100000 allowed"
                ));
            }
            let sound = Beats::Grid(*grid).check();
            sound.map_err(|error| format!("beats: {}", error.with_hint()))?;
            if self.beats_per_bar.is_some() {
                return Err(
                    "beats_per_bar is for tracked beats; `beats` has one of its own".to_owned(),
                );
            }
            if self.downbeat_seconds.is_some() {
                return Err(
                    "downbeat_seconds is for tracked beats; `beats` begins with a bar".to_owned(),
                );
            }
        }
        if self.beats_per_bar == Some(0) {
            return Err("beats_per_bar = 0: at least 1 allowed".to_owned());
        }
        if self.grid.is_some() && self.segments.is_empty() {
            return Err("grid is for segments; a whole take stays as it was recorded".to_owned());
        }
        if !self.segments.is_empty() {
            let idle = [
                ("motion_start_seconds", self.motion_start_seconds != 0.0),
                ("motion_end_seconds", self.motion_end_seconds.is_some()),
                ("audio_start_seconds", self.audio_start_seconds != 0.0),
            ];
            if let Some((key, _)) = idle.iter().find(|(_, given)| *given) {
                return Err(format!(
                    "{key} is for whole takes; segments have `frames` and follow `beats`"
                ));
            }
        }
        let broken = self.segments.iter().position(|segment| {
            let [from, to] = segment.frames;
            let ordered = from.is_finite() && to.is_finite() && 0.0 <= from && from < to;
            !(ordered && segment.beats.is_finite() && segment.beats > 0.0)
        });
        match broken {
            Some(index) => Err(format!(
                "segment {index}: two increasing frames and a positive number of beats allowed"
            )),
            None => Ok(()),
        }
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
