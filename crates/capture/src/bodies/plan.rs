//! What a plan says of clips: captures, how they are cut, labels and captions.

use std::collections::{BTreeMap, BTreeSet};

use kinegrad_settings::{InvalidSetting, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::captions::{TAKE, placeholders};
use crate::UpAxis;
use crate::prepare::{LEAST_FPS, SMALLEST_UNIT, Units, check_end, check_name, check_number};

/// The columns of the manifest that labels do not take.
const COLUMNS: [&str; 14] = [
    "id",
    "take",
    "file",
    "map",
    "first_frame",
    "frames",
    "seconds",
    "fps",
    "mirrored",
    "split",
    "caption",
    "captions",
    "features_bytes",
    "features_sha256",
];

/// The fewest and most frames that a plan can ask of a clip.
const FRAMES: std::ops::RangeInclusive<usize> = 4..=10_000;

/// How clips are made of captures.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ClipsPlan {
    /// Frames of the shortest clip. Shorter takes are left out, and the report lists them.
    pub min_frames: usize,
    /// Frames of the longest clip. Longer takes are cut into clips of about the same length.
    pub max_frames: usize,
    /// Whether captures are brought to 20 frames per second, the rate of HumanML3D. With `false`
    /// they keep their own, and readers, which take all clips to have 20, see them slowed down.
    pub resample: bool,
    /// Whether bodies are given the bones of one skeleton. With `false` they keep their own.
    pub retarget: bool,
    /// Whether each clip is written a second time with left and right exchanged, in its labels and
    /// captions too, with an `M` before its id.
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
    /// A capture file (.bvh, .c3d); `*` in its name takes every file that matches.
    pub motion: String,
    /// Begins the ids of its clips; `{name}` stands for the motion file's name without ending,
    /// which is also the default.
    pub name: Option<String>,
    /// The joint map of BVH files: `bandai`, `cmu`, `humanml3d`, `mixamo`, `xsens`, `forefoot`, or a TOML
    /// file; found by the names of the joints unless stated.
    pub map: Option<String>,
    /// Metres of one unit of a BVH file, or its name; found by the length of the legs unless stated.
    pub units: Option<Units>,
    /// The axis that points up; found by where the head is unless stated.
    pub up: Option<UpAxis>,
    /// Frames per second, where the file's own frame time is wrong.
    pub fps: Option<f64>,
    /// Seconds into the file at which to begin.
    #[serde(default)]
    pub motion_start_seconds: f64,
    /// Seconds into the file at which to end.
    pub motion_end_seconds: Option<f64>,
    /// Where the labels come from.
    #[serde(default)]
    pub labels: LabelsPlan,
    /// A CSV file of captions: a column `file` with the name of the motion file, columns whose names
    /// begin with `caption`, and any others, which are labels. A file may have several rows.
    pub captions: Option<String>,
}

/// Where the labels of captures come from. If a label comes from several places, the later of these
/// keys decides.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LabelsPlan {
    /// Pattern of the motion file's name without ending, as `*_{content}_{style}_{take}`: each name
    /// in braces becomes a label. `take` is the number of the take, by which takes are held out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// A JSON file with an object whose entries are labels; `{name}` stands for the motion file's
    /// name without ending, as in `captures/{name}.json`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub json: Option<String>,
    /// What the numbers of the JSON file mean: the names by label, counted from 0, or a text file
    /// with one a line.
    pub json_names: BTreeMap<String, Names>,
    /// Labels that all of the captures have.
    pub fixed: BTreeMap<String, String>,
}

/// A list of names.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(untagged, try_from = "toml::Value")]
#[schemars(!try_from)]
pub enum Names {
    /// In the plan.
    List(Vec<String>),
    /// In a text file, one a line.
    File(String),
}

impl TryFrom<toml::Value> for Names {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        match value {
            toml::Value::String(file) => Ok(Self::File(file)),
            value => texts(value)
                .map(Self::List)
                .ok_or_else(|| "expected a list of names, or a text file with one a line".into()),
        }
    }
}

/// The texts of a list of them.
fn texts(value: toml::Value) -> Option<Vec<String>> {
    let toml::Value::Array(values) = value else {
        return None;
    };
    let texts = values.into_iter().map(|value| match value {
        toml::Value::String(text) => Some(text),
        _ => None,
    });
    texts.collect()
}

/// Captions that are made of labels.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CaptionsPlan {
    /// Sentences with labels in braces, as `a person {content} {style}`.
    pub templates: Vec<String>,
    /// How sentences say a label: by label and value one phrase, or several, which take turns. A
    /// value without a phrase stands for itself, with spaces for `-` and `_`.
    pub words: BTreeMap<String, BTreeMap<String, Phrases>>,
}

/// One phrase or several.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(untagged, try_from = "toml::Value")]
#[schemars(!try_from)]
pub enum Phrases {
    /// One.
    One(String),
    /// Several.
    Several(Vec<String>),
}

impl TryFrom<toml::Value> for Phrases {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        match value {
            toml::Value::String(phrase) => Ok(Self::One(phrase)),
            value => texts(value)
                .map(Self::Several)
                .ok_or_else(|| "expected a phrase, or a list of phrases".into()),
        }
    }
}

impl Phrases {
    /// All of them.
    pub fn all(&self) -> &[String] {
        match self {
            Self::One(phrase) => std::slice::from_ref(phrase),
            Self::Several(phrases) => phrases,
        }
    }
}

impl ClipsPlan {
    /// # Errors
    /// Names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        in_range("clips.min_frames", self.min_frames, FRAMES)?;
        in_range(
            "clips.max_frames",
            self.max_frames,
            self.min_frames..=*FRAMES.end(),
        )
    }
}

impl CapturePlan {
    /// # Errors
    /// Names the key.
    pub(crate) fn check(&self) -> Result<(), InvalidSetting> {
        check_name(self.name.as_deref())?;
        check_end(self.motion_start_seconds, self.motion_end_seconds)?;
        check_number("units", self.units.map(Units::metres), SMALLEST_UNIT)?;
        check_number("fps", self.fps, LEAST_FPS)?;
        let pattern = self.labels.name.as_deref().unwrap_or_default();
        let key = "labels.name";
        let odd = |problem| InvalidSetting::new(key, format!("\"{pattern}\""), problem);
        let labels = placeholders(pattern).map_err(odd)?;
        let labels = labels.iter().filter(|label| *label != TAKE);
        let labels = labels.map(|label| (key, label));
        let fixed = self
            .labels
            .fixed
            .keys()
            .map(|label| ("labels.fixed", label));
        let names = self.labels.json_names.keys();
        let names = names.map(|label| ("labels.json_names", label));
        for (key, label) in labels.chain(fixed).chain(names) {
            check_label(label).map_err(|problem| {
                InvalidSetting::new(key, format!("a label `{label}`"), problem)
            })?;
        }
        let needed = self.labels.json_names.is_empty() || self.labels.json.is_some();
        let allowed = "the file that `labels.json_names` is about";
        require(needed, "labels.json", "missing", allowed)
    }
}

/// Rejects names that a label cannot have.
pub(crate) fn check_label(label: &str) -> Result<(), String> {
    let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let begins = label.starts_with(|c: char| c.is_ascii_lowercase());
    match begins && label.chars().all(letters) && !COLUMNS.contains(&label) {
        true => Ok(()),
        false => Err(format!(
            "small letters, digits and _, but for {}",
            COLUMNS.join(", ")
        )),
    }
}

impl CaptionsPlan {
    /// # Errors
    /// Names the key.
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
