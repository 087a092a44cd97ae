//! What samples are asked for.

use std::path::PathBuf;

use kinegrad_motion::{MAX_FRAMES, PostProcessProfile};
use kinegrad_settings::{ABOVE_ZERO, Refused, in_range};

use super::{Given, GivenFrames, Style};
use crate::checkpoint::SavedCheckpoint;
use crate::error::Error;
use crate::song::KnownBeats;

/// A request for samples. Systems reject conditions that their models do not support.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// The conditions.
    pub conditions: Conditions,
    /// Samples per condition.
    pub count: usize,
    /// Frames to generate.
    pub frames: Option<usize>,
    /// Seconds to generate, in the place of `frames`: [`sample`](super::sample) makes frames of them.
    pub seconds: Option<f64>,
    /// Seed of the noise.
    pub seed: u64,
    /// Repairs of the generated motion, for models with such; the default ones if not said.
    pub post_processing: Option<PostProcessProfile>,
}

/// The sources of conditions.
#[derive(Clone, Debug, Default)]
pub struct Conditions {
    /// Dataset that contains the item, instead of the run's own.
    pub source: Option<String>,
    /// Id of the item, or a pattern.
    pub item: Option<String>,
    /// File of audio features.
    pub audio_features: Option<PathBuf>,
    /// Song.
    pub song: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts.
    pub start: f64,
    /// What is known of the song's beats.
    pub beats: KnownBeats,
    /// Goal files.
    pub goals: Vec<PathBuf>,
    /// Checkpoint of the trajectory model that generates the ground path in a first stage.
    pub trajectory: Option<SavedCheckpoint>,
    /// Text, in words.
    pub text: Option<String>,
    /// Folder of the text encoder that embeds the text.
    pub clip: Option<PathBuf>,
    /// Text embedding, `FILE#KEY`.
    pub text_embedding: Option<String>,
    /// File of joints that the motion goes on from.
    pub history: Option<PathBuf>,
    /// File of texts with their lengths, one after another.
    pub plan: Option<PathBuf>,
    /// File of a path over the ground.
    pub path: Option<PathFile>,
    /// Frames of a phrase that the sample has as they are.
    pub given: Option<Given>,
    /// The style, for models that are conditioned on one.
    pub style: Option<Style>,
    /// Use the first so many held-out items of the run's own dataset.
    pub held_out: Option<usize>,
}

/// A path over the ground, in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct PathFile {
    /// The file.
    pub file: PathBuf,
    /// Metres of a unit, where it is a drawing.
    pub metres_per_unit: Option<f64>,
}

impl Request {
    /// Rejects requests that contradict themselves, whatever the model.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first contradiction; it names the options of the command line.
    pub fn validate(&self) -> Result<(), Error> {
        if self.count == 0 {
            return Err(Error::usage(
                "`--count` is 0",
                "ask for at least one sample",
            ));
        }
        if let Some(frames) = self.frames {
            in_range("--frames", frames, 1..=MAX_FRAMES)
                .hint("leave it out for the length of the condition, or of the training")?;
        }
        if let Some(seconds) = self.seconds {
            if self.frames.is_some() {
                let hint = "both say how long the motion is: leave out one of the two";
                return Err(Error::usage("`--seconds` with `--frames`", hint));
            }
            in_range("--seconds", seconds, ABOVE_ZERO)
                .hint("leave it out for the length of the condition, or of the training")?;
        }
        self.conditions.validate()
    }

    /// The same with frames for the seconds, at so many frames a second.
    ///
    /// # Errors
    /// If that is no frame or too many.
    pub(super) fn at(&self, fps: f64) -> Result<Self, Error> {
        let Some(seconds) = self.seconds else {
            return Ok(self.clone());
        };
        let frames = (seconds * fps).round();
        in_range("--seconds", seconds, 1.0 / fps..=MAX_FRAMES as f64 / fps)?;
        Ok(Self {
            frames: Some(frames as usize),
            seconds: None,
            ..self.clone()
        })
    }
}

impl Conditions {
    /// Whether none is given, so that the system chooses one.
    pub fn is_empty(&self) -> bool {
        !self.given().iter().any(|(_, given)| *given) && self.held_out.is_none()
    }

    /// The conditions by their command-line names, and whether each is given.
    fn given(&self) -> [(&'static str, bool); 15] {
        let continues = |given: &Given| given.frames == GivenFrames::Last;
        [
            ("--source", self.source.is_some()),
            ("--item", self.item.is_some()),
            ("--audio-features", self.audio_features.is_some()),
            ("--audio", self.song.is_some()),
            ("--goal", !self.goals.is_empty()),
            ("--trajectory-run", self.trajectory.is_some()),
            ("--text", self.text.is_some()),
            ("--text-encoder", self.clip.is_some()),
            ("--text-embedding", self.text_embedding.is_some()),
            ("--history", self.history.is_some()),
            ("--prompts", self.plan.is_some()),
            ("--path", self.path.is_some()),
            (
                "--continue-from",
                self.given.as_ref().is_some_and(continues),
            ),
            (
                "--keep",
                self.given.as_ref().is_some_and(|given| !continues(given)),
            ),
            ("--style", self.style.is_some()),
        ]
    }

    fn validate(&self) -> Result<(), Error> {
        let given = self.given();
        let is_given = |name: &str| given.iter().any(|(known, given)| *known == name && *given);
        for (kind, one, other) in CONTRADICTORY {
            if is_given(one) && is_given(other) {
                return Err(Error::usage(
                    format!("`{one}` with `{other}`"),
                    format!("a motion has one {kind} condition: leave out one of the two"),
                ));
            }
        }
        if self.held_out.is_some() && given.iter().any(|(_, given)| *given) {
            let (name, _) = given.iter().find(|(_, given)| *given).expect("just found");
            return Err(Error::usage(
                format!("`{name}` with held-out items"),
                "held-out items have their own conditions: leave out one of the two",
            ));
        }
        if self.held_out == Some(0) {
            return Err(Error::usage(
                "0 held-out items are asked for",
                "ask for at least one",
            ));
        }
        let start = self.start;
        if !(start.is_finite() && start >= 0.0) {
            return Err(Error::usage(
                format!("`--start` is {start}"),
                "give a position in the song, in seconds from 0",
            ));
        }
        if let (None, Some(option)) = (&self.song, self.beats.given().first()) {
            return Err(Error::usage(
                format!("`{option}` without `--audio`"),
                "it is about the beats of a song: pass `--audio SONG` too",
            ));
        }
        if self.clip.is_some() && self.text.is_none() {
            return Err(Error::usage(
                "`--text-encoder` without `--text`",
                "it embeds a text: pass `--text SENTENCE` too",
            ));
        }
        self.beats.validate()?;
        if start > 0.0 && self.song.is_none() {
            return Err(Error::usage(
                "`--start` without `--audio`",
                "it is a position in a song: pass `--audio SONG` too",
            ));
        }
        Ok(())
    }

    /// Rejects conditions that are set but listed in `unknown`, by their command-line names.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first that is set.
    pub fn refuse(&self, unknown: &[&str], why: &str, hint: &str) -> Result<(), Error> {
        let mut given = self.given().into_iter();
        match given.find(|(name, given)| *given && unknown.contains(name)) {
            Some((name, _)) => Err(Error::usage(format!("`{name}` with {why}"), hint)),
            None => Ok(()),
        }
    }
}

/// Conditions that exclude each other, with what they are conditions on.
const CONTRADICTORY: [(&str, &str, &str); 11] = [
    ("audio", "--audio-features", "--item"),
    ("audio", "--audio-features", "--source"),
    ("audio", "--audio", "--audio-features"),
    ("audio", "--audio", "--item"),
    ("audio", "--audio", "--source"),
    ("text", "--text", "--text-embedding"),
    ("text", "--text", "--prompts"),
    ("text", "--text-embedding", "--prompts"),
    ("position", "--goal", "--path"),
    ("position", "--keep", "--path"),
    ("position", "--continue-from", "--path"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_that_contradict_themselves_are_refused() {
        let song = || Some(PathBuf::from("song.mp3"));
        let conditions = |change: fn(&mut Conditions)| {
            let mut conditions = Conditions {
                song: Some("song.mp3".into()),
                ..Conditions::default()
            };
            change(&mut conditions);
            Request {
                conditions,
                count: 1,
                ..Request::default()
            }
        };
        let cases: [(Request, &str); 10] = [
            (Request::default(), "`--count` is 0"),
            (
                Request {
                    frames: Some(0),
                    ..conditions(|_| {})
                },
                "`--frames` is 0",
            ),
            (
                conditions(|c| c.item = Some("a".into())),
                "`--audio` with `--item`",
            ),
            (
                conditions(|c| c.audio_features = Some("a.npz".into())),
                "`--audio` with `--audio-features`",
            ),
            (
                conditions(|c| {
                    c.song = None;
                    c.audio_features = Some("a.npz".into());
                    c.source = Some("phrases".into());
                }),
                "`--audio-features` with `--source`",
            ),
            (
                conditions(|c| {
                    c.song = None;
                    c.start = 3.0;
                }),
                "`--start` without `--audio`",
            ),
            (conditions(|c| c.start = f64::NAN), "`--start` is NaN"),
            (
                conditions(|c| c.beats.tempo = Some(-1.0)),
                "`--tempo` is -1",
            ),
            (
                conditions(|c| {
                    c.song = None;
                    c.beats.downbeat = Some(1.0);
                }),
                "`--downbeat` without `--audio`",
            ),
            (
                conditions(|c| c.held_out = Some(2)),
                "`--audio` with held-out items",
            ),
        ];
        for (request, expected) in cases {
            let error = request.validate().expect_err(expected);
            assert!(error.to_string().starts_with(expected), "{error}");
        }
        let good = Request {
            conditions: Conditions {
                song: song(),
                start: 12.5,
                ..Conditions::default()
            },
            count: 1,
            frames: Some(30),
            ..Request::default()
        };
        good.validate().expect("a song from a moment on");
        assert!(!good.conditions.is_empty());
        assert!(Conditions::default().is_empty());
    }
}
