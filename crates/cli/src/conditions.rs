//! The conditions of a request, from options of the command line or arguments in Python.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::humanml::Joints;
use kinegrad_train::Error;
use kinegrad_train::sampling::{
    Condition, GoalCondition, KnownFramesCondition, OtherCondition, PathFile, Style,
    TrajectoryCondition,
};

use crate::args::BeatArguments;
use crate::checkpoint;
use crate::io::{BvhReading, is_bvh, read_body};

/// Options that name conditions.
#[derive(Clone, Debug, Default, Args)]
pub struct ConditionArguments {
    /// Dataset that contains the item [default: the run's dataset]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Dataset item that gives the condition; `*` matches any text, and each match writes
    /// PATH-ID.npy
    #[arg(long, value_name = "ID", conflicts_with = "audio_features")]
    pub item: Option<String>,
    /// Audio features as the condition: `features.npz`, or an array `[163, frames]`
    #[arg(long, value_name = "FILE", conflicts_with = "source")]
    pub audio_features: Option<PathBuf>,
    /// Song (mp3, wav, flac, ogg) as the condition
    #[arg(long, value_name = "SONG", conflicts_with_all = ["source", "item", "audio_features"])]
    pub audio: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts
    #[arg(long, value_name = "S", default_value_t = 0.0, requires = "audio")]
    pub start: f64,
    /// Known beats of the song.
    #[command(flatten)]
    pub beats: BeatArguments,
    /// Goal of the root: key frames or a trajectory, and obstacles; several goals are sampled as
    /// one batch
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that generates the ground path first
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Text as the condition, embedded with `--text-encoder`; for runs with
    /// `data.humanml3d.text = "labels"`, one of the training captions
    #[arg(long, value_name = "SENTENCE", conflicts_with = "text_embedding")]
    pub text: Option<String>,
    /// Folder of CLIP ViT-B/32, which embeds the text
    #[arg(long, value_name = "DIR", requires = "text")]
    pub text_encoder: Option<PathBuf>,
    /// Text embedding as the condition: 512 values in tensor KEY of a safetensors file; KEY:N
    /// selects row N of the tensor
    #[arg(long, value_name = "FILE#KEY")]
    pub text_embedding: Option<String>,
    /// Motion to continue, for runs of recipe `flow`: joint positions `[T, J, 3]` in meters (.npy), or
    /// a capture (.bvh)
    #[arg(long, value_name = "MOTION")]
    pub history: Option<PathBuf>,
    /// Sequence of texts with their lengths, for runs of recipe `flow` or `bpe_motion`
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["text", "text_embedding"])]
    pub prompts: Option<PathBuf>,
    /// Path over the ground that the motion follows (.toml, .csv or .svg)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Method of following the path [default: from the run's config]. Recipe `bpe_motion`: `none`,
    /// `warp`, `override`, `guidance`, `override_guidance`, `tokens`, `tokens_guidance` or
    /// `tokens_warp`; phrases: `override` or `guidance`
    #[arg(long, value_name = "METHOD", requires = "path")]
    pub method: Option<String>,
    /// Meters per unit, if the path is a drawing
    #[arg(long, value_name = "METRES", requires = "path")]
    pub metres_per_unit: Option<f64>,
    /// Style, for runs with `model.style`: a label, such as `waltz`, or eight numbers separated by
    /// commas [default: none]
    #[arg(long, value_name = "STYLE", allow_hyphen_values = true)]
    pub style: Option<String>,
    /// Phrase to continue; the sample begins with the phrase's end, a quarter of the training
    /// length
    #[arg(long, value_name = "MOTION.npy", conflicts_with = "keep")]
    pub continue_from: Option<PathBuf>,
    /// Frames taken unchanged from `--keep-from`, for example 0..30,90..120 (without 30 and 120)
    #[arg(long, value_name = "FRAMES", requires = "keep_from")]
    pub keep: Option<String>,
    /// Phrase that contains the frames of `--keep`
    #[arg(long, value_name = "MOTION.npy", requires = "keep")]
    pub keep_from: Option<PathBuf>,
    /// Number of held-out items used as conditions; not an option.
    #[arg(skip)]
    pub held_out: Option<usize>,
    /// Condition of a system outside of kinegrad; the value is JSON, or text
    #[arg(long = "condition", value_name = "NAME=VALUE", hide = true)]
    pub other: Vec<String>,
}

impl ConditionArguments {
    /// The joints of a history in a BVH file, with the bones of the HumanML3D skeleton.
    ///
    /// # Errors
    /// If the file is not a body.
    pub fn history_joints(&self) -> Result<Option<Joints>, Error> {
        let capture = self.history.as_ref().filter(|file| is_bvh(file));
        capture
            .map(|file| read_body(file, &BvhReading::default(), true))
            .transpose()
    }

    /// The conditions.
    ///
    /// # Errors
    /// [`Error::Usage`] for a bad value, an argument without its required argument, or a trajectory
    /// run without a checkpoint.
    pub fn conditions(self) -> Result<Vec<Condition>, Error> {
        self.must_belong()?;
        let mut conditions = Vec::new();
        let source = self.source;
        conditions.extend(self.item.map(|id| Condition::Item { id, source }));
        conditions.extend(self.audio_features.map(Condition::AudioFeatures));
        let (start, beats) = (self.start, self.beats.known());
        conditions.extend(
            self.audio
                .map(|file| Condition::Song { file, start, beats }),
        );
        let goals = self.goal.into_iter().map(|file| GoalCondition {
            file,
            goal: None,
            sha256: None,
        });
        conditions.extend(goals.map(Condition::Goal));
        if let Some(run) = &self.trajectory_run {
            let trajectory = TrajectoryCondition::new(checkpoint(run)?);
            conditions.push(Condition::Trajectory(trajectory));
        }
        let text_encoder = self.text_encoder;
        conditions.extend(self.text.map(|text| Condition::Text { text, text_encoder }));
        conditions.extend(self.text_embedding.map(Condition::TextEmbedding));
        conditions.extend(self.prompts.map(Condition::Prompts));
        conditions.extend(self.history.map(Condition::History));
        let metres_per_unit = self.metres_per_unit;
        conditions.extend(self.path.map(|file| {
            Condition::Path(PathFile {
                file,
                metres_per_unit,
            })
        }));
        if let Some(motion) = &self.continue_from {
            let known = KnownFramesCondition::continued(motion);
            conditions.push(Condition::KnownFrames(known));
        }
        if let (Some(motion), Some(frames)) = (&self.keep_from, &self.keep) {
            let known = KnownFramesCondition::in_place(motion, frames)?;
            conditions.push(Condition::KnownFrames(known));
        }
        if let Some(style) = &self.style {
            conditions.push(Condition::Style(Style::parse(style)?));
        }
        conditions.extend(self.held_out.map(Condition::HeldOut));
        for text in &self.other {
            conditions.push(Condition::Other(other(text)?));
        }
        Ok(conditions)
    }

    /// Rejects arguments without their required argument, and conflicting arguments.
    fn must_belong(&self) -> Result<(), Error> {
        let beats = self.beats.known().given();
        let of_beats = beats.first().copied().unwrap_or("tempo");
        let options = [
            ("source", self.source.is_some()),
            ("item", self.item.is_some()),
            ("start", self.start != 0.0),
            (of_beats, !beats.is_empty()),
            ("song", self.audio.is_some()),
            ("text_encoder", self.text_encoder.is_some()),
            ("text", self.text.is_some()),
            ("metres_per_unit", self.metres_per_unit.is_some()),
            ("path", self.path.is_some()),
            ("keep", self.keep.is_some()),
            ("keep_from", self.keep_from.is_some()),
        ];
        let is_set = |option: &str| options.contains(&(option, true));
        for (name, owner) in [
            ("source", "item"),
            ("start", "song"),
            (of_beats, "song"),
            ("text_encoder", "text"),
            ("metres_per_unit", "path"),
            ("keep", "keep_from"),
            ("keep_from", "keep"),
        ] {
            if is_set(name) && !is_set(owner) {
                return Err(Error::usage(
                    format!("option `{name}` without option `{owner}`"),
                    format!("pass option `{owner}` too"),
                ));
            }
        }
        if self.continue_from.is_some() && self.keep.is_some() {
            return Err(Error::usage(
                "option `continue_from` with option `keep`",
                "a sample continues a motion, or keeps frames of one: leave out one of the two",
            ));
        }
        Ok(())
    }
}

fn other(text: &str) -> Result<OtherCondition, Error> {
    let (name, value) = text.split_once('=').ok_or_else(|| {
        let hint = "for example option `condition radius=1.5`";
        Error::usage(format!("option `condition {text}` is not NAME=VALUE"), hint)
    })?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    OtherCondition::new(name.trim(), value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_without_their_owner_are_refused() {
        type Change = fn(&mut ConditionArguments);
        let cases: [(Change, &str); 9] = [
            (
                |a| a.source = Some("set".into()),
                "`source` without option `item`",
            ),
            (|a| a.start = 2.0, "`start` without option `song`"),
            (
                |a| a.beats.downbeat = Some(1.0),
                "`downbeat` without option `song`",
            ),
            (
                |a| a.text_encoder = Some("clip".into()),
                "`text_encoder` without option `text`",
            ),
            (
                |a| a.metres_per_unit = Some(0.1),
                "`metres_per_unit` without option `path`",
            ),
            (
                |a| a.keep = Some("0..3".into()),
                "`keep` without option `keep_from`",
            ),
            (
                |a| a.keep_from = Some("a.npy".into()),
                "`keep_from` without option `keep`",
            ),
            (
                |a| {
                    a.continue_from = Some("a.npy".into());
                    a.keep = Some("0..3".into());
                    a.keep_from = Some("a.npy".into());
                },
                "`continue_from` with option `keep`",
            ),
            (|a| a.other = vec!["text=walk".into()], "`condition text`"),
        ];
        for (change, expected) in cases {
            let mut arguments = ConditionArguments::default();
            change(&mut arguments);
            let error = arguments.conditions().expect_err(expected).to_string();
            assert!(error.starts_with(&format!("option {expected}")), "{error}");
        }
    }
}
