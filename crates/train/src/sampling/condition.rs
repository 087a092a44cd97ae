//! The conditions of samples.

use std::fmt;
use std::path::PathBuf;

use kinegrad_motion::goal::Goal;
use kinegrad_output::path_text;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde::ser::{SerializeMap, Serializer};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Style;
use crate::checkpoint::SavedCheckpoint;
use crate::error::Error;
use crate::song::KnownBeats;

/// A condition of a sample, in requests and in the sample's record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// Items of a dataset: their audio features, captions or first frames.
    Item {
        /// Id of the item, or a pattern in a request.
        id: String,
        /// The dataset; the run's dataset if `None`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        source: Option<String>,
    },
    /// A number of held-out items of the run's dataset, from the first on.
    HeldOut(usize),
    /// A file of audio features.
    AudioFeatures(#[serde(serialize_with = "path_text")] PathBuf),
    /// A song.
    Song {
        /// Its file.
        #[serde(serialize_with = "path_text")]
        file: PathBuf,
        /// Position in the song at which the motion starts, seconds.
        start: f64,
        /// Known facts about the song's beats.
        #[serde(default, skip_serializing_if = "KnownBeats::is_empty")]
        beats: KnownBeats,
    },
    /// The style of a phrase.
    Style(Style),
    /// A text.
    Text {
        /// The text, in words.
        text: String,
        /// Folder of the text encoder, for models that take embeddings.
        #[serde(
            default,
            skip_serializing_if = "Option::is_none",
            serialize_with = "path_text"
        )]
        text_encoder: Option<PathBuf>,
    },
    /// The embedding of a text, `FILE#KEY`.
    TextEmbedding(String),
    /// A file of texts over time.
    Prompts(#[serde(serialize_with = "path_text")] PathBuf),
    /// Position control of the root.
    Goal(GoalCondition),
    /// A trajectory model that generates the ground path in a first stage.
    Trajectory(TrajectoryCondition),
    /// A file of joints that the motion continues.
    History(#[serde(serialize_with = "path_text")] PathBuf),
    /// A path over the ground.
    Path(PathFile),
    /// Frames of another motion that the sample contains unchanged.
    KnownFrames(KnownFramesCondition),
    /// A condition of a system outside of kinegrad.
    #[serde(untagged)]
    Other(OtherCondition),
}

/// A condition of a system outside of kinegrad, in JSON a map with one entry.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherCondition {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: Value,
}

impl Serialize for OtherCondition {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(1))?;
        map.serialize_entry(&self.name, &self.value)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for OtherCondition {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let map = serde_json::Map::deserialize(deserializer)?;
        let mut entries = map.into_iter();
        match (entries.next(), entries.next()) {
            (Some((name, value)), None) => {
                Self::new(&name, value).map_err(serde::de::Error::custom)
            }
            _ => Err(serde::de::Error::custom(
                "a map with one condition is needed",
            )),
        }
    }
}

/// A goal file and, once it is read, its contents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalCondition {
    /// The file, as given.
    #[serde(serialize_with = "path_text")]
    pub file: PathBuf,
    /// The goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
    /// SHA-256 of the file's contents.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// The checkpoint of a trajectory model.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrajectoryCondition {
    /// Its folder.
    #[serde(serialize_with = "path_text")]
    pub checkpoint: PathBuf,
    /// The checkpoint itself, in a request.
    #[serde(skip)]
    pub saved: Option<Box<SavedCheckpoint>>,
}

impl TrajectoryCondition {
    /// The condition on the trajectory model of a checkpoint.
    pub fn new(saved: SavedCheckpoint) -> Self {
        Self {
            checkpoint: saved.path.clone(),
            saved: Some(Box::new(saved)),
        }
    }
}

impl PartialEq for TrajectoryCondition {
    fn eq(&self, other: &Self) -> bool {
        self.checkpoint == other.checkpoint
    }
}

/// A path over the ground, in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathFile {
    /// The file.
    #[serde(serialize_with = "path_text")]
    pub file: PathBuf,
    /// Meters per unit of a drawing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metres_per_unit: Option<f64>,
}

/// Frames of another motion that the sample contains unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KnownFramesCondition {
    /// The motion's file.
    #[serde(serialize_with = "path_text")]
    pub motion: PathBuf,
    /// Start and end of each range, ascending and disjoint; empty for the last frames.
    pub frames: Vec<[usize; 2]>,
    /// True if the sample starts with these frames; otherwise the frames keep their positions.
    pub continued: bool,
}

/// Names that conditions of other systems cannot have.
const RESERVED: [&str; 16] = [
    "item",
    "held_out",
    "audio_features",
    "song",
    "style",
    "text",
    "text_embedding",
    "prompts",
    "goal",
    "trajectory",
    "history",
    "path",
    "known_frames",
    "continue_from",
    "keep",
    "postprocess",
];

impl OtherCondition {
    /// The condition `name`.
    ///
    /// # Errors
    /// [`Error::Usage`] for a reserved name.
    pub fn new(name: &str, value: Value) -> Result<Self, Error> {
        match RESERVED.contains(&name) {
            false => Ok(Self {
                name: name.to_string(),
                value,
            }),
            true => Err(Error::usage(
                format!("option `condition {name}` is not a condition of another system"),
                format!("use option `{name}`"),
            )),
        }
    }
}

impl Condition {
    /// The condition's name; recipes list the names of accepted conditions.
    pub fn name(&self) -> &str {
        match self {
            Self::Item { .. } => "item",
            Self::HeldOut(_) => "held_out",
            Self::AudioFeatures(_) => "audio_features",
            Self::Song { .. } => "song",
            Self::Style(_) => "style",
            Self::Text { .. } => "text",
            Self::TextEmbedding(_) => "text_embedding",
            Self::Prompts(_) => "prompts",
            Self::Goal(_) => "goal",
            Self::Trajectory(_) => "trajectory",
            Self::History(_) => "history",
            Self::Path(_) => "path",
            Self::KnownFrames(known) if known.continued => "continue_from",
            Self::KnownFrames(_) => "keep",
            Self::Other(other) => &other.name,
        }
    }

    /// The group of conditions of which a sample has at most one.
    pub(super) fn role(&self) -> Option<&'static str> {
        match self {
            Self::AudioFeatures(_) | Self::Song { .. } => Some("audio"),
            Self::Text { .. } | Self::TextEmbedding(_) | Self::Prompts(_) => Some("text"),
            Self::Goal(_) | Self::Path(_) | Self::KnownFrames(_) => Some("position"),
            _ => None,
        }
    }
}

/// Conditions in JSON: a map with one entry per condition.
pub(super) mod as_map {
    use super::*;

    pub fn serialize<S: Serializer>(
        conditions: &[Condition],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(conditions.len()))?;
        for condition in conditions {
            let entry = serde_json::to_value(condition).map_err(serde::ser::Error::custom)?;
            let Value::Object(entry) = entry else {
                unreachable!("a condition is a map");
            };
            for (name, value) in entry {
                map.serialize_entry(&name, &value)?;
            }
        }
        map.end()
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<Condition>, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Vec<Condition>;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a map of conditions")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut conditions = Vec::new();
                while let Some((name, value)) = map.next_entry::<String, Value>()? {
                    let entry = Value::Object([(name, value)].into_iter().collect());
                    conditions
                        .push(serde_json::from_value(entry).map_err(serde::de::Error::custom)?);
                }
                Ok(conditions)
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Recorded {
        #[serde(with = "as_map")]
        condition: Vec<Condition>,
    }

    #[test]
    fn records_of_all_conditions_read_back_equal() {
        let file = || PathBuf::from("f");
        let conditions = [
            Condition::Item {
                id: "a".into(),
                source: Some("set".into()),
            },
            Condition::HeldOut(3),
            Condition::AudioFeatures(file()),
            Condition::Song {
                file: file(),
                start: 1.5,
                beats: KnownBeats {
                    tempo: Some(90.0),
                    ..KnownBeats::default()
                },
            },
            Condition::Style(Style::Label("waltz".into())),
            Condition::Text {
                text: "a".into(),
                text_encoder: None,
            },
            Condition::TextEmbedding("f#a".into()),
            Condition::Prompts(file()),
            Condition::Goal(GoalCondition {
                file: file(),
                goal: Some(Goal::new(16)),
                sha256: Some("0".into()),
            }),
            Condition::Trajectory(TrajectoryCondition {
                checkpoint: file(),
                saved: None,
            }),
            Condition::History(file()),
            Condition::Path(PathFile {
                file: file(),
                metres_per_unit: Some(0.1),
            }),
            Condition::KnownFrames(KnownFramesCondition {
                motion: file(),
                frames: vec![[0, 4]],
                continued: true,
            }),
            Condition::Other(OtherCondition::new("radius", 1.5.into()).expect("a name")),
        ];
        for condition in conditions {
            let name = condition.name().to_string();
            let recorded = Recorded {
                condition: vec![condition],
            };
            let text = serde_json::to_string(&recorded).expect("plain data");
            let read: Recorded = serde_json::from_str(&text).expect(&name);
            assert_eq!(read, recorded, "{text}");
        }
        for bad in [r#"{"goal": {"file": 3}}"#, r#"{"item": 3}"#] {
            let text = format!("{{\"condition\": {bad}}}");
            assert!(serde_json::from_str::<Recorded>(&text).is_err(), "{text}");
        }
        assert!(OtherCondition::new("text", Value::Null).is_err());
    }
}
