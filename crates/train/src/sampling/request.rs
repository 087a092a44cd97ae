//! Requests for samples.

use std::path::Path;

use kinegrad_motion::humanml::Joints;
use kinegrad_motion::{MAX_FRAMES, PostProcessProfile};
use kinegrad_settings::{ABOVE_ZERO, Refused, in_range};

use super::{
    BestOf, Condition, GoalCondition, KnownFramesCondition, PathFile, Style, TrajectoryCondition,
};
use crate::error::Error;

/// Most samples per condition.
const MAX_SAMPLES: usize = 1_000_000_000;

/// A request for samples.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// The conditions; without conditions the system chooses one, or samples unconditionally.
    pub conditions: Vec<Condition>,
    /// Joint positions of the history in metres, for a [`Condition::History`] whose file is not an
    /// array.
    pub history_joints: Option<Joints>,
    /// Samples per condition.
    pub count: usize,
    /// Frames to generate.
    pub frames: Option<usize>,
    /// Seconds to generate, instead of `frames`:
    /// [`Systems::sample`](crate::system::Systems::sample) converts them.
    pub seconds: Option<f64>,
    /// Seed of the noise.
    pub seed: u64,
    /// Post-processing, for models that have one; that of the config if `None`.
    pub post_processing: Option<PostProcessProfile>,
    /// The number of samples of which the best is kept, for a `count` of 1.
    pub best_of: Option<BestOf>,
}

impl Request {
    /// A request for one sample for each of the first `count` held-out items.
    pub fn held_out(count: usize, seed: u64) -> Self {
        Self {
            conditions: vec![Condition::HeldOut(count)],
            count: 1,
            seed,
            ..Self::default()
        }
    }

    /// Rejects contradictory requests, independently of the model.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first contradiction.
    pub fn validate(&self) -> Result<(), Error> {
        in_range("option count", self.count, 1..=MAX_SAMPLES)
            .hint("request more samples in several commands, with other seeds")?;
        let hint = "leave it out for the length of the condition, or of the training";
        if let Some(frames) = self.frames {
            in_range("option frames", frames, 1..=MAX_FRAMES).hint(hint)?;
        }
        if let Some(seconds) = self.seconds {
            if self.frames.is_some() {
                return Err(Error::usage(
                    "option `seconds` with option `frames`",
                    "both set the length of the motion: leave out one of the two",
                ));
            }
            in_range("option seconds", seconds, ABOVE_ZERO).hint(hint)?;
        }
        if let Some(best_of) = &self.best_of {
            in_range("option best_of", best_of.count, 2..=MAX_SAMPLES)
                .hint("one sample is kept: give the number of samples that it is selected from")?;
            let other = match (self.count, self.held_out_items()) {
                (1, None) => None,
                (1, Some(_)) => Some("held-out items"),
                _ => Some("option `count`"),
            };
            if let Some(other) = other {
                return Err(Error::usage(
                    format!("option `best_of` with {other}"),
                    "one sample of each condition is kept: leave out one of the two",
                ));
            }
        }
        if self.held_out_items().is_some() && self.count != 1 {
            return Err(Error::usage(
                format!("option `count` is {} with held-out items", self.count),
                "held-out items get one sample each: leave it out",
            ));
        }
        self.validate_conditions()
    }

    fn validate_conditions(&self) -> Result<(), Error> {
        for (index, one) in self.conditions.iter().enumerate() {
            for other in &self.conditions[..index] {
                let same = one.name() == other.name() && !matches!(one, Condition::Goal(_));
                let role = one.role().filter(|role| other.role() == Some(role));
                let role = role.filter(|_| one.name() != other.name());
                // An item of phrases has audio features; items of clips have none.
                let audio = |a: &Condition, b: &Condition| {
                    matches!(a, Condition::Item { .. }) && b.role() == Some("audio")
                };
                let role = match audio(one, other) || audio(other, one) {
                    true => Some("audio"),
                    false => role,
                };
                if let (Condition::HeldOut(_), second) | (second, Condition::HeldOut(_)) =
                    (one, other)
                {
                    return Err(Error::usage(
                        format!("option `{}` with held-out items", second.name()),
                        "held-out items have their own conditions: leave out one of the two",
                    ));
                }
                if same || role.is_some() {
                    let what = role.unwrap_or(one.name());
                    return Err(Error::usage(
                        format!("option `{}` with option `{}`", one.name(), other.name()),
                        format!("a motion has one {what} condition: leave out one of the two"),
                    ));
                }
            }
        }
        self.find(invalid).map_or(Ok(()), Err)
    }

    /// The request with frames instead of seconds, at `fps` frames per second.
    ///
    /// # Errors
    /// For less than one frame or too many frames.
    pub fn at(&self, fps: f64) -> Result<Self, Error> {
        let Some(seconds) = self.seconds else {
            return Ok(self.clone());
        };
        let frames = (seconds * fps).round();
        in_range(
            "option `seconds`",
            seconds,
            1.0 / fps..=MAX_FRAMES as f64 / fps,
        )?;
        Ok(Self {
            frames: Some(frames as usize),
            seconds: None,
            ..self.clone()
        })
    }

    fn find<'a, T>(&'a self, of: impl FnMut(&'a Condition) -> Option<T>) -> Option<T> {
        self.conditions.iter().find_map(of)
    }

    /// True if the system chooses the condition.
    pub fn is_unconditional(&self) -> bool {
        self.conditions.is_empty()
    }

    /// Id or pattern of an item, and its dataset if different from the run's.
    pub fn item(&self) -> Option<(&str, Option<&str>)> {
        self.find(|condition| match condition {
            Condition::Item { id, source } => Some((id.as_str(), source.as_deref())),
            _ => None,
        })
    }

    /// Number of held-out items.
    pub fn held_out_items(&self) -> Option<usize> {
        self.find(|condition| match condition {
            Condition::HeldOut(count) => Some(*count),
            _ => None,
        })
    }

    /// The goals.
    pub fn goals(&self) -> impl Iterator<Item = &GoalCondition> {
        self.conditions
            .iter()
            .filter_map(|condition| match condition {
                Condition::Goal(goal) => Some(goal),
                _ => None,
            })
    }

    /// The trajectory model.
    pub fn trajectory(&self) -> Option<&TrajectoryCondition> {
        self.find(|condition| match condition {
            Condition::Trajectory(trajectory) => Some(trajectory),
            _ => None,
        })
    }

    /// The file of the history.
    pub fn history(&self) -> Option<&Path> {
        self.find(|condition| match condition {
            Condition::History(file) => Some(file.as_path()),
            _ => None,
        })
    }

    /// The file of prompts.
    pub fn prompts(&self) -> Option<&Path> {
        self.find(|condition| match condition {
            Condition::Prompts(file) => Some(file.as_path()),
            _ => None,
        })
    }

    /// The path.
    pub fn path(&self) -> Option<&PathFile> {
        self.find(|condition| match condition {
            Condition::Path(path) => Some(path),
            _ => None,
        })
    }

    /// The known frames.
    pub fn known_frames(&self) -> Option<&KnownFramesCondition> {
        self.find(|condition| match condition {
            Condition::KnownFrames(known) => Some(known),
            _ => None,
        })
    }

    /// The style.
    pub fn style(&self) -> Option<&Style> {
        self.find(|condition| match condition {
            Condition::Style(style) => Some(style),
            _ => None,
        })
    }

    /// The text conditions, for the record of a sample.
    pub fn text_conditions(&self) -> impl Iterator<Item = Condition> {
        let texts = self.conditions.iter().cloned();
        texts.filter(|condition| condition.role() == Some("text"))
    }

    /// The value of a condition of a system outside of kinegrad.
    pub fn other(&self, name: &str) -> Option<&serde_json::Value> {
        self.find(|condition| match condition {
            Condition::Other(other) if other.name == name => Some(&other.value),
            _ => None,
        })
    }
}

/// The error of a condition that is invalid for every model.
fn invalid(condition: &Condition) -> Option<Error> {
    match condition {
        Condition::HeldOut(0) => Some(Error::usage(
            "0 held-out items are requested",
            "request at least one",
        )),
        Condition::Song { start, .. } if !(start.is_finite() && *start >= 0.0) => {
            Some(Error::usage(
                format!("option `start` is {start}"),
                "give a position in the song, in seconds from 0",
            ))
        }
        Condition::Song { beats, .. } => beats.validate().err(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::song::KnownBeats;

    #[test]
    fn requests_that_contradict_themselves_are_refused() {
        let song = |start: f64, beats: KnownBeats| Condition::Song {
            file: "song.mp3".into(),
            start,
            beats,
        };
        let plain = || song(12.5, KnownBeats::default());
        let item = || Condition::Item {
            id: "a".into(),
            source: None,
        };
        let features = || Condition::AudioFeatures("a.npz".into());
        let text = || Condition::Text {
            text: "a".into(),
            text_encoder: None,
        };
        let goal = || {
            Condition::Goal(GoalCondition {
                file: "g".into(),
                goal: None,
                sha256: None,
            })
        };
        let path = || {
            Condition::Path(PathFile {
                file: "p".into(),
                metres_per_unit: None,
            })
        };
        let request = |conditions: Vec<Condition>| Request {
            conditions,
            count: 1,
            ..Request::default()
        };
        let best_of = |of: usize, count: usize, conditions| Request {
            best_of: Some(BestOf {
                count: of,
                by: Vec::new(),
            }),
            count,
            ..request(conditions)
        };
        let slow = KnownBeats {
            tempo: Some(-1.0),
            ..KnownBeats::default()
        };
        for (request, expected) in [
            (
                Request::default(),
                "`option count` is 0, allowed: 1 to 1000000000",
            ),
            (
                Request {
                    frames: Some(0),
                    ..request(vec![plain()])
                },
                "`option frames` is 0",
            ),
            (
                request(vec![plain(), item()]),
                "option `item` with option `song`",
            ),
            (
                request(vec![features(), plain()]),
                "option `song` with option `audio_features`",
            ),
            (
                request(vec![text(), Condition::Prompts("p".into())]),
                "option `prompts` with option `text`",
            ),
            (request(vec![item(), item()]), "option `item` with"),
            (best_of(1, 1, vec![item()]), "`option best_of` is 1"),
            (
                best_of(4, 2, vec![item()]),
                "option `best_of` with option `count`",
            ),
            (
                best_of(4, 1, vec![Condition::HeldOut(1)]),
                "option `best_of` with held-out items",
            ),
            (
                request(vec![goal(), path()]),
                "option `path` with option `goal`",
            ),
            (
                request(vec![song(f64::NAN, KnownBeats::default())]),
                "option `start` is NaN",
            ),
            (request(vec![song(0.0, slow)]), "option `tempo` is -1"),
            (
                request(vec![plain(), Condition::HeldOut(2)]),
                "option `song` with held-out items",
            ),
        ] {
            let error = request.validate().expect_err(expected);
            assert!(error.to_string().starts_with(expected), "{error}");
        }
        for good in [vec![plain()], vec![item(), text()], vec![goal(), goal()]] {
            request(good).validate().expect("conditions that agree");
        }
    }
}
