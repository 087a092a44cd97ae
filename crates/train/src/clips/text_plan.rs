//! The file of `kinegrad sample --prompts`: successive texts with durations.

use std::path::Path;

use kinegrad_data::file::read_text;
use kinegrad_data::humanml::read_embedding;
use kinegrad_motion::MAX_FRAMES;
use kinegrad_settings::{ABOVE_ZERO, Document, in_range};
use serde::{Deserialize, Serialize};

use super::captions::{ClipText, TextInput};
use crate::error::Error;
use crate::sampling::{PromptRecord, Request};

/// Successive texts with durations.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct TextPlan {
    step: Vec<TextStep>,
}

/// One prompt and its duration.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct TextStep {
    seconds: f64,
    /// The text; without a text the motion continues unconditionally.
    text: Option<String>,
    /// The text's embedding instead, `FILE#KEY`.
    text_embedding: Option<String>,
}

impl TextPlan {
    /// Reads and checks a file.
    fn read(path: &Path) -> Result<Self, Error> {
        let hint = "a plan is a list of `[[step]]`, each with `seconds` and `text` or \
                    `text_embedding`: docs/compose.md";
        let file = path.display().to_string();
        let refused = |reason: String| Error::usage(format!("{file}: {reason}"), hint);
        let text = read_text(path).map_err(|error| refused(error.to_string()))?;
        let document = Document::parse(&text, &file)?;
        let plan: Self = document.read(hint)?;
        if plan.step.is_empty() {
            return Err(refused("it has no step".into()));
        }
        for (number, step) in plan.step.iter().enumerate() {
            in_range(format!("step[{number}].seconds"), step.seconds, ABOVE_ZERO)
                .map_err(|setting| document.refuse(setting))?;
            if step.text.is_some() && step.text_embedding.is_some() {
                let both = format!("step[{number}] has both `text` and `text_embedding`");
                return Err(refused(both));
            }
        }
        Ok(plan)
    }

    /// The number of frames of each step at `fps` frames per second. `path` is the file of prompts.
    fn lengths(&self, path: &Path, fps: f64) -> Result<Vec<usize>, Error> {
        let file = path.display();
        let (mut seconds, mut begin) = (0.0, 0);
        let length = |(number, step): (usize, &TextStep)| {
            seconds += step.seconds;
            let end = (seconds * fps).round();
            if end > MAX_FRAMES as f64 {
                let message = format!("{file}: it has more than {MAX_FRAMES} frames");
                return Err(Error::usage(message, "make it shorter"));
            }
            let length = (end as usize).saturating_sub(begin);
            if length == 0 {
                let message = format!("{file}: step[{number}] is shorter than a frame");
                return Err(Error::usage(message, format!("a second has {fps} frames")));
            }
            begin += length;
            Ok(length)
        };
        self.step.iter().enumerate().map(length).collect()
    }

    /// The text of each step, in the form of `input`. `path` is the file of prompts.
    fn texts(&self, path: &Path, input: &TextInput) -> Result<Vec<Option<ClipText>>, Error> {
        let of_step = |(number, step): (usize, &TextStep)| {
            let refused = |message: &str, hint: &str| {
                let place = format!("{}: step[{number}]", path.display());
                Error::usage(format!("{place}: {message}"), hint)
            };
            if step.text.is_some() && input.labels().is_none() {
                let hint = "`text_embedding = \"FILE#KEY\"`: `kinegrad text embed` makes the file";
                return Err(refused(
                    "`text`, and the run takes embeddings of texts",
                    hint,
                ));
            }
            let embedding = step.text_embedding.as_deref().map(read_embedding);
            let text = ClipText {
                caption: step.text.clone(),
                embedding: embedding.transpose()?,
            };
            if text == ClipText::default() {
                return Ok(None);
            }
            input.values(&text).map_err(|error| match error {
                Error::Usage { message, hint } => refused(&message, &hint),
                other => other,
            })?;
            Ok(Some(text))
        };
        self.step.iter().enumerate().map(of_step).collect()
    }
}

/// A text for some frames of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPrompt {
    /// The text; `None` for unconditional motion.
    pub text: Option<ClipText>,
    /// Number of frames, at least 1.
    pub frames: usize,
}

impl TimedPrompt {
    /// The texts of a motion with their first frames, for the motion's record.
    pub fn records(prompts: &[Self]) -> Vec<PromptRecord> {
        let mut from = 0;
        let record = |prompt: &Self| {
            let begins = from;
            from += prompt.frames;
            PromptRecord {
                from: begins,
                text: prompt.text.as_ref().and_then(|text| text.caption.clone()),
            }
        };
        prompts.iter().map(record).collect()
    }

    /// The texts of a request's file, in the form of `input`; `None` without a file.
    ///
    /// # Errors
    /// If the request also sets a length, the file cannot be read, or a text is unknown.
    pub fn requested(
        request: &Request,
        input: &TextInput,
        fps: f64,
    ) -> Result<Option<Vec<Self>>, Error> {
        let Some(path) = request.prompts() else {
            return Ok(None);
        };
        if request.frames.is_some() {
            let hint = "the file sets the length of the motion: leave option `frames` or option \
                        `seconds` out";
            return Err(Error::usage("option `prompts` with a length", hint));
        }
        let plan = TextPlan::read(path)?;
        let lengths = plan.lengths(path, fps)?;
        let texts = plan.texts(path, input)?.into_iter();
        let prompts = texts
            .zip(lengths)
            .map(|(text, frames)| Self { text, frames });
        Ok(Some(prompts.collect()))
    }
}
