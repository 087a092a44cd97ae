//! The conditions of a request, from the arguments of the command line and of Python.

use std::path::PathBuf;

use kinegrad_train::Error;
use kinegrad_train::sampling::{
    Condition, GoalCondition, KnownFramesCondition, OtherCondition, PathFile, Style,
    TrajectoryCondition,
};
use kinegrad_train::song::KnownBeats;

use crate::checkpoint;

/// Arguments that name conditions. Each is documented at its flag.
#[derive(Clone, Debug, Default)]
#[allow(missing_docs)]
pub struct ConditionArguments {
    pub source: Option<String>,
    pub item: Option<String>,
    pub audio_features: Option<PathBuf>,
    pub audio: Option<PathBuf>,
    pub start: f64,
    pub beats: KnownBeats,
    pub goal: Vec<PathBuf>,
    pub trajectory_run: Option<PathBuf>,
    pub text: Option<String>,
    pub text_encoder: Option<PathBuf>,
    pub text_embedding: Option<String>,
    pub prompts: Option<PathBuf>,
    pub history: Option<PathBuf>,
    pub path: Option<PathBuf>,
    pub metres_per_unit: Option<f64>,
    pub style: Option<String>,
    pub continue_from: Option<PathBuf>,
    pub keep: Option<String>,
    pub keep_from: Option<PathBuf>,
    pub held_out: Option<usize>,
    /// `NAME=VALUE` of a system outside of kinegrad; the value is JSON, or text.
    pub other: Vec<String>,
}

impl ConditionArguments {
    /// The conditions.
    ///
    /// # Errors
    /// [`Error::Usage`] for an argument without the one that it belongs to, or a bad value; if the
    /// trajectory run has no checkpoint.
    pub fn conditions(self) -> Result<Vec<Condition>, Error> {
        self.must_belong()?;
        let mut conditions = Vec::new();
        let source = self.source;
        conditions.extend(self.item.map(|id| Condition::Item { id, source }));
        conditions.extend(self.audio_features.map(Condition::AudioFeatures));
        let (start, beats) = (self.start, self.beats);
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
            let known = KnownFramesCondition::kept(motion, frames)?;
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

    /// Rejects arguments without the one that they belong to.
    fn must_belong(&self) -> Result<(), Error> {
        let beats = self.beats.given();
        let of_beats = beats.first().copied().unwrap_or("tempo");
        for (is_set, name, owner, has) in [
            (self.source.is_some(), "source", "item", self.item.is_some()),
            (self.start != 0.0, "start", "song", self.audio.is_some()),
            (!beats.is_empty(), of_beats, "song", self.audio.is_some()),
            (
                self.text_encoder.is_some(),
                "text_encoder",
                "text",
                self.text.is_some(),
            ),
            (
                self.metres_per_unit.is_some(),
                "metres_per_unit",
                "path",
                self.path.is_some(),
            ),
            (
                self.keep.is_some(),
                "keep",
                "keep_from",
                self.keep_from.is_some(),
            ),
            (
                self.keep_from.is_some(),
                "keep_from",
                "keep",
                self.keep.is_some(),
            ),
        ] {
            if is_set && !has {
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
