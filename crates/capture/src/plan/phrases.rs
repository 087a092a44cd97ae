//! The part of a plan that is about phrases: takes, their music, and their lengths.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;

use kinegrad_data::{AudioGroup, AudioLayout, is_label};
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::limits::{LEAST_FPS, MOST, SMALLEST_UNIT, check_end, check_name, check_number};
use super::units::Units;
use crate::{BeatGrid, Beats, MarkerMap, UpAxis};

/// Length of phrases and their audio features.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhrasesPlan {
    /// Frames of a phrase, at 30 per second.
    pub frames: usize,
    /// Frames from the start of one phrase to the start of the next.
    pub hop: usize,
    /// Groups of audio features that are stored: `["ccmotion"]`, or `["ccmotion", "beats"]` to add the
    /// position in beat and bar, beat marks and local tempo.
    pub audio_features: Vec<AudioGroup>,
}

impl Default for PhrasesPlan {
    fn default() -> Self {
        Self {
            frames: 120,
            hop: 120,
            audio_features: AudioLayout::CCMOTION.groups(),
        }
    }
}

/// A recording with its music.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TakePlan {
    /// Prefix of the ids of its phrases. `{name}` stands for the motion file's name without ending and
    /// is the default.
    pub name: Option<String>,
    /// A capture file (.bvh, .c3d, .npy, .npz). With `*` in its name, each matching file is a take.
    pub motion: Option<String>,
    /// Segments of capture files, each placed on beats of the music; replaces `motion`.
    #[serde(default, rename = "segment")]
    pub segments: Vec<SegmentPlan>,
    /// Start in the motion file, seconds.
    #[serde(default)]
    pub motion_start_seconds: f64,
    /// End in the motion file, seconds. The default is the file's end.
    pub motion_end_seconds: Option<f64>,
    /// A song (.mp3, .wav, .flac, .ogg), or `none`. `{name}` stands for the motion file's name without
    /// ending, `*` for any characters.
    pub audio: String,
    /// Time in the song at which the motion starts, seconds.
    #[serde(default)]
    pub audio_start_seconds: f64,
    /// The beats, if they are known. The default is to track them in the song.
    pub beats: Option<BeatGrid>,
    /// Beats in a bar of tracked beats. The default is 4.
    pub beats_per_bar: Option<u32>,
    /// Time of a downbeat in the song, seconds, if the beats are tracked: the nearest tracked beat
    /// starts a bar. Without this time the first beat starts a bar, and beat features have no
    /// position in the bar.
    pub downbeat_seconds: Option<f64>,
    /// The beats that segments are aligned with. The default is the beats tracked in the song if
    /// their number is within 2 % of the number of `beats`, otherwise even beats.
    pub grid: Option<Grid>,
    /// Metres of one unit of a BVH file, or the unit's name. The default is centimetres.
    pub units: Option<Units>,
    /// The axis of a BVH file that points up. The default is y.
    pub up: Option<UpAxis>,
    /// The joint of a BVH file that is the root. The default is the first.
    pub joint: Option<String>,
    /// The markers of a C3D file that define the root. The default is Plug-in Gait's waist markers.
    pub markers: Option<MarkerMap>,
    /// Frames per second of .npy and .npz files. The default is 30.
    pub fps: Option<f64>,
    /// The dance, such as `waltz`: a style that models with `model.style` can be conditioned on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
}

/// A segment of a capture file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SegmentPlan {
    /// The capture file. If it is missing, the segment is a gap.
    pub motion: String,
    /// First and last frame in the file, counted from 0; fractions are allowed.
    pub frames: [f64; 2],
    /// Its length in beats. The first segment starts at the first beat, each other segment at the
    /// end of the previous one.
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
    /// A song; `{type}` and `{id}` stand for the dance's type and id.
    pub music: String,
    /// Dance types with three beats in a bar.
    #[serde(default = "waltz")]
    pub three_beats_per_bar: Vec<String>,
    /// The markers that define the root.
    #[serde(default)]
    pub markers: MarkerMap,
    /// The beats that units are aligned with; see `take.grid`.
    pub grid: Option<Grid>,
    /// Label of the phrases by dance type, for example `{ W = "waltz" }`; see `take.label`.
    #[serde(default)]
    pub labels: BTreeMap<String, String>,
}

fn waltz() -> Vec<String> {
    vec!["W".to_owned()]
}

/// The beats that segments are aligned with.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grid {
    /// Beats tracked in the song, counted from the tracked beat nearest to the start of `beats`.
    Tracked,
    /// Even beats from the start of `beats`.
    Uniform,
}

impl TakePlan {
    /// Checks everything except the files; an error names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        let label = self.label.as_deref().unwrap_or("x");
        let found = format!("\"{label}\"");
        let allowed = "a word without a comma that is not a number";
        require(is_label(label), "label", found, allowed)?;
        let pieces = !self.segments.is_empty();
        let allowed = "either `motion` or [[take.segment]]";
        let found = ["missing", "given with segments"][usize::from(pieces)];
        require(self.motion.is_some() != pieces, "motion", found, allowed)?;
        if pieces {
            let allowed = "the beats that segments are aligned with";
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
        let allowed = "where beats are tracked; `beats` states its own bars";
        for (key, is_set) in [
            ("beats_per_bar", self.beats_per_bar.is_some()),
            ("downbeat_seconds", self.downbeat_seconds.is_some()),
        ] {
            require(!is_set || self.beats.is_none(), key, "given", allowed)?;
        }
        let allowed = "in whole takes; segments have `frames` and follow `beats`";
        for (key, is_set) in [
            ("motion_start_seconds", self.motion_start_seconds != 0.0),
            ("motion_end_seconds", self.motion_end_seconds.is_some()),
            ("audio_start_seconds", self.audio_start_seconds != 0.0),
        ] {
            require(!is_set || !pieces, key, "given", allowed)?;
        }
        let allowed = "for segments; a whole take is not moved";
        require(self.grid.is_none() || pieces, "grid", "given", allowed)?;
        let beats_per_bar = u64::from(self.beats_per_bar.unwrap_or(1));
        in_range("beats_per_bar", beats_per_bar, 1..)?;
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
    pub(crate) fn check_kinds(&self, files: &[&Path]) -> Result<(), String> {
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
        match keys
            .iter()
            .find(|(_, is_set, kinds)| *is_set && !has(kinds))
        {
            Some((key, _, kinds)) => Err(format!(
                "`{key}` is for .{} files, and this take has none",
                kinds.join(" and .")
            )),
            None => Ok(()),
        }
    }
}
