//! What a plan says of clips: captures, how they are cut, labels and captions.

use std::collections::{BTreeMap, BTreeSet};

use kinegrad_data::check_id;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::captions::{TAKE, placeholders};
use crate::UpAxis;
use crate::prepare::Units;

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
    /// In an error, the key and what is wrong with it.
    pub(crate) fn check(&self) -> Result<(), String> {
        let (least, most) = (self.min_frames, self.max_frames);
        match FRAMES.contains(&least) && FRAMES.contains(&most) && least <= most {
            true => Ok(()),
            false => Err(format!(
                "clips.min_frames = {least}, clips.max_frames = {most}: {} to {} allowed, the first \
                 at most the second",
                FRAMES.start(),
                FRAMES.end()
            )),
        }
    }
}

impl CapturePlan {
    /// In an error, the key and what is wrong with it.
    pub(crate) fn check(&self) -> Result<(), String> {
        if let Some(name) = &self.name {
            check_id(&name.replace("{name}", "x")).map_err(|error| error.to_string())?;
        }
        for (key, value, least) in [
            ("motion_start_seconds", Some(self.motion_start_seconds), 0.0),
            ("units", self.units.map(Units::metres), 1e-9),
            ("fps", self.fps, 0.1),
        ] {
            if let Some(value) = value
                && !(least..=1e5).contains(&value)
            {
                return Err(format!("{key} = {value}: a number from {least} allowed"));
            }
        }
        let after = |end: f64| end > self.motion_start_seconds && end.is_finite();
        if !self.motion_end_seconds.is_none_or(after) {
            return Err("motion_end_seconds must come after motion_start_seconds".to_owned());
        }
        let pattern = self.labels.name.as_deref().unwrap_or_default();
        let named = placeholders(pattern).map_err(|problem| format!("labels.name: {problem}"))?;
        let labels = named.iter().map(String::as_str);
        let labels = labels.filter(|label| *label != TAKE);
        let given = self
            .labels
            .fixed
            .keys()
            .chain(self.labels.json_names.keys());
        labels
            .chain(given.map(String::as_str))
            .try_for_each(check_label)?;
        if !self.labels.json_names.is_empty() && self.labels.json.is_none() {
            return Err("labels.json_names is for labels.json, which is not given".to_owned());
        }
        Ok(())
    }
}

/// Rejects names that a label cannot have.
pub(crate) fn check_label(label: &str) -> Result<(), String> {
    let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let begins = label.starts_with(|c: char| c.is_ascii_lowercase());
    match begins && label.chars().all(letters) && !COLUMNS.contains(&label) {
        true => Ok(()),
        false => Err(format!(
            "a label called `{label}`: small letters, digits and _ allowed, but for {}",
            COLUMNS.join(", ")
        )),
    }
}

impl CaptionsPlan {
    /// In an error, the key and what is wrong with it.
    pub(crate) fn check(&self) -> Result<(), String> {
        let mut used = BTreeSet::new();
        for template in &self.templates {
            let named = placeholders(template);
            used.extend(named.map_err(|problem| format!("captions.templates: {problem}"))?);
            if template.contains(['#', '\n']) || template.trim().is_empty() {
                return Err(format!(
                    "captions.templates: `{template}`: a sentence without # and line ends allowed"
                ));
            }
        }
        for (label, words) in &self.words {
            if !used.contains(label) {
                return Err(format!(
                    "captions.words.{label}: no template has {{{label}}} in it"
                ));
            }
            for (value, phrases) in words {
                let odd = |phrase: &String| phrase.contains(['#', '\n', '{', '}']);
                if phrases.all().is_empty() || phrases.all().iter().any(odd) {
                    return Err(format!(
                        "captions.words.{label}.{value}: a phrase without #, braces and line ends \
                         allowed, or a list of them"
                    ));
                }
            }
        }
        Ok(())
    }
}
