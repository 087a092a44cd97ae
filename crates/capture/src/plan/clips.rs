//! The part of a plan that is about clips: captures, their lengths, labels and captions.

use std::collections::{BTreeMap, BTreeSet};

use kinegrad_settings::{InvalidSetting, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::limits::{LEAST_FPS, SMALLEST_UNIT, check_end, check_name, check_number};
use super::pattern::{TAKE, placeholders};
use super::units::Units;
use crate::UpAxis;

/// The columns of the manifest, whose names labels cannot have.
const COLUMNS: &str = "id, take, file, map, first_frame, frames, seconds, fps, mirrored, split, \
     caption, captions, features_bytes, features_sha256";

/// The fewest and most frames of a clip that a plan can set.
const FRAMES: std::ops::RangeInclusive<usize> = 4..=10_000;

/// Length of clips, frame rate and bones.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ClipsPlan {
    /// Frames of the shortest clip. Shorter takes are skipped, and the report lists them.
    pub min_frames: usize,
    /// Frames of the longest clip. Longer takes are cut into clips of about the same length.
    pub max_frames: usize,
    /// Resamples captures to 20 frames per second, the rate of HumanML3D. With `false` captures
    /// keep their own rate, but readers assume 20 for all clips and see such clips at another
    /// speed.
    pub resample: bool,
    /// Gives all bodies the bones of one skeleton. With `false` bodies keep their own bones.
    pub retarget: bool,
    /// Writes each clip a second time with left and right exchanged, also in labels and captions,
    /// and an `M` before its id.
    pub mirror: bool,
}

impl Default for ClipsPlan {
    fn default() -> Self {
        Self {
            min_frames: 40,
            max_frames: 196,
            resample: true,
            retarget: true,
            mirror: true,
        }
    }
}

/// Captures of one kind.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CapturePlan {
    /// A capture file (.bvh, .c3d). With `*` in its name, each matching file is a take.
    pub motion: String,
    /// Prefix of the ids of its clips. `{name}` stands for the motion file's name without ending and is
    /// the default.
    pub name: Option<String>,
    /// The joint map of BVH files: `bandai`, `cmu`, `humanml3d`, `mixamo`, `xsens`, `forefoot`, or a TOML
    /// file. The default is the built-in map that fits the names of the joints.
    pub map: Option<String>,
    /// Metres of one unit of a BVH file, or the unit's name. The default is found from the length
    /// of the legs.
    pub units: Option<Units>,
    /// The axis that points up. The default is found from the place of the head.
    pub up: Option<UpAxis>,
    /// Frames per second, if the file's own frame time is wrong.
    pub fps: Option<f64>,
    /// Start in the file, seconds.
    #[serde(default)]
    pub motion_start_seconds: f64,
    /// End in the file, seconds. The default is the file's end.
    pub motion_end_seconds: Option<f64>,
    /// Sources of the labels.
    #[serde(default)]
    pub labels: LabelsPlan,
    /// A CSV file of captions: a column `file` with the name of the motion file, columns of captions
    /// whose names begin with `caption`, and columns of labels. A motion file may have several rows.
    pub captions: Option<String>,
}

/// Sources of the labels of captures. If several sources have the same label, the last of these
/// keys decides.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LabelsPlan {
    /// Pattern of the motion file's name without ending, such as `*_{content}_{style}_{take}`: each
    /// name in braces becomes a label. `take` is the number of the take, by which takes are held out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// A JSON file with an object of labels. `{name}` stands for the motion file's name without ending,
    /// as in `captures/{name}.json`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub json: Option<String>,
    /// Names for the numbers of the JSON file, by label: a list, counted from 0, or a text file with
    /// one name per line.
    pub json_names: BTreeMap<String, Names>,
    /// Labels of all of the captures.
    pub fixed: BTreeMap<String, String>,
}

/// A list of names.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(untagged, try_from = "toml::Value")]
#[schemars(!try_from)]
pub enum Names {
    /// In the plan.
    List(Vec<String>),
    /// In a text file, one per line.
    File(String),
}

impl TryFrom<toml::Value> for Names {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        match value {
            toml::Value::String(file) => Ok(Self::File(file)),
            value => {
                let expected = "expected a list of names, or a text file with one a line";
                Ok(Self::List(value.try_into().map_err(|_| expected)?))
            }
        }
    }
}

/// Captions made from labels.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CaptionsPlan {
    /// Sentences with labels in braces, such as `a person {content} {style}`.
    pub templates: Vec<String>,
    /// Wordings by label and value: one wording, or several that are used in turn. The default is
    /// the value itself, with spaces for `-` and `_`.
    pub words: BTreeMap<String, BTreeMap<String, Wordings>>,
}

/// One wording or several.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(untagged, try_from = "toml::Value")]
#[schemars(!try_from)]
pub enum Wordings {
    /// One.
    One(String),
    /// Several.
    Several(Vec<String>),
}

impl TryFrom<toml::Value> for Wordings {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        match value {
            toml::Value::String(phrase) => Ok(Self::One(phrase)),
            value => {
                let expected = "expected a wording, or a list of wordings";
                Ok(Self::Several(value.try_into().map_err(|_| expected)?))
            }
        }
    }
}

impl Wordings {
    /// All of them.
    pub fn all(&self) -> &[String] {
        match self {
            Self::One(phrase) => std::slice::from_ref(phrase),
            Self::Several(phrases) => phrases,
        }
    }
}

impl ClipsPlan {
    /// An error names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        in_range("clips.min_frames", self.min_frames, FRAMES)?;
        let frames = self.min_frames..=*FRAMES.end();
        in_range("clips.max_frames", self.max_frames, frames)
    }
}

impl CapturePlan {
    /// An error names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        check_name(self.name.as_deref())?;
        check_end(self.motion_start_seconds, self.motion_end_seconds)?;
        check_number("units", self.units.map(Units::metres), SMALLEST_UNIT)?;
        check_number("fps", self.fps, LEAST_FPS)?;
        let pattern = self.labels.name.as_deref().unwrap_or_default();
        let key = "labels.name";
        let odd = |problem| InvalidSetting::new(key, format!("\"{pattern}\""), problem);
        let labels = placeholders(pattern).map_err(odd)?;
        for label in labels.iter().filter(|label| *label != TAKE) {
            check_label(key, label)?;
        }
        for label in self.labels.fixed.keys() {
            check_label("labels.fixed", label)?;
        }
        for label in self.labels.json_names.keys() {
            check_label("labels.json_names", label)?;
        }
        let needed = self.labels.json_names.is_empty() || self.labels.json.is_some();
        let allowed = "the file that `labels.json_names` is about";
        require(needed, "labels.json", "missing", allowed)
    }
}

/// Rejects a name, found at `key`, that a label cannot have.
pub(crate) fn check_label(key: &str, label: &str) -> Result<(), InvalidSetting> {
    let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let begins = label.starts_with(|c: char| c.is_ascii_lowercase());
    let sound =
        begins && label.chars().all(letters) && COLUMNS.split(", ").all(|column| column != label);
    let found = format!("a label called `{label}`");
    let allowed = format!("small letters, digits and _, but for {COLUMNS}");
    require(sound, key, found, allowed)
}

impl CaptionsPlan {
    /// An error names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        let mut used = BTreeSet::new();
        for (index, template) in self.templates.iter().enumerate() {
            let key = format!("captions.templates[{index}]");
            let found = format!("\"{template}\"");
            let odd = |problem| InvalidSetting::new(&key, &found, problem);
            used.extend(placeholders(template).map_err(odd)?);
            let plain = !template.contains(['#', '\n']) && !template.trim().is_empty();
            require(plain, key, found, "a sentence without # and line ends")?;
        }
        for (label, words) in &self.words {
            let key = format!("captions.words.{label}");
            let allowed = format!("labels of templates, and none has {{{label}}} in it");
            require(used.contains(label), &key, "given", allowed)?;
            for (value, phrases) in words {
                let odd = |phrase: &String| phrase.contains(['#', '\n', '{', '}']);
                let sound = !phrases.all().is_empty() && !phrases.all().iter().any(odd);
                let allowed = "a phrase without #, braces and line ends, or a list of them";
                let found = format!("{:?}", phrases.all());
                require(sound, format!("{key}.{value}"), found, allowed)?;
            }
        }
        Ok(())
    }
}
