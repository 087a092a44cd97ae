//! The file of `kinegrad sample --prompts`: successive texts with durations.

use std::path::Path;

use kinegrad_data::file::read_text;
use kinegrad_data::humanml::read_embedding;
use kinegrad_motion::MAX_FRAMES;
use kinegrad_settings::{ABOVE_ZERO, Document, in_range};
use serde::{Deserialize, Serialize};

use super::captions::{ClipText, TextInput};
use crate::error::Error;
use crate::sampling::{Request, SaidRecord};

/// Successive texts with durations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextPlan {
    /// In order.
    pub step: Vec<TextStep>,
}

/// One prompt and its duration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextStep {
    /// Duration, seconds.
    pub seconds: f64,
    /// The text; without one the motion continues unconditionally.
    pub text: Option<String>,
    /// The text's embedding instead, `FILE#KEY`.
    pub text_embedding: Option<String>,
}

impl TextPlan {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// Names the file, the line and the fault.
    pub fn read(path: &Path) -> Result<Self, Error> {
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

    /// The end frame of each step at `fps` frames per second. `path` is the plan's file.
    ///
    /// # Errors
    /// [`Error::Usage`] for a step of no frame, and more frames than a motion may have.
    pub fn ends(&self, path: &Path, fps: f64) -> Result<Vec<usize>, Error> {
        let file = path.display();
        let mut seconds = 0.0;
        let mut ends = Vec::with_capacity(self.step.len());
        for (number, step) in self.step.iter().enumerate() {
            seconds += step.seconds;
            let end = (seconds * fps).round();
            if end > MAX_FRAMES as f64 {
                let message = format!("{file}: it has more than {MAX_FRAMES} frames");
                return Err(Error::usage(message, "make it shorter"));
            }
            let end = end as usize;
            if end <= ends.last().copied().unwrap_or(0) {
                let message = format!("{file}: step[{number}] is shorter than a frame");
                return Err(Error::usage(message, format!("a second has {fps} frames")));
            }
            ends.push(end);
        }
        Ok(ends)
    }

    /// The text condition of each step, in the form of `input`; `None` for a step without a text.
    /// `path` is the file of prompts.
    ///
    /// # Errors
    /// [`Error::Usage`] for a text that the model does not know, with the file and the step; if an
    /// embedding cannot be read.
    pub fn texts(&self, path: &Path, input: &TextInput) -> Result<Vec<ClipText>, Error> {
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
            let text = step.clip_text()?.unwrap_or_default();
            if text != ClipText::default() {
                input.values(&text).map_err(|error| match error {
                    Error::Usage { message, hint } => refused(&message, &hint),
                    other => other,
                })?;
            }
            Ok(text)
        };
        self.step.iter().enumerate().map(of_step).collect()
    }
}

/// A text for some frames of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPrompt {
    /// The text; `None` for unconditional motion.
    pub text: Option<ClipText>,
    /// Its frames, at least 1.
    pub frames: usize,
}

impl TimedPrompt {
    /// The texts of a motion with their first frames, for its record.
    pub fn records(prompts: &[Self]) -> Vec<SaidRecord> {
        let mut from = 0;
        let record = |prompt: &Self| {
            let begins = from;
            from += prompt.frames;
            SaidRecord {
                from: begins,
                text: prompt.text.as_ref().and_then(|text| text.caption.clone()),
            }
        };
        prompts.iter().map(record).collect()
    }

    /// The texts of a request's file for a model with this text `input`; `None` without a file.
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
        let ends = plan.ends(path, fps)?;
        let begins = [0].into_iter().chain(ends.iter().copied());
        let lengths = ends.iter().zip(begins).map(|(end, begin)| end - begin);
        let texts = plan.texts(path, input)?.into_iter();
        let prompts = texts.zip(lengths).map(|(text, frames)| Self {
            text: (text != ClipText::default()).then_some(text),
            frames,
        });
        Ok(Some(prompts.collect()))
    }
}

impl TextStep {
    /// The text.
    ///
    /// # Errors
    /// If the embedding cannot be read.
    pub fn clip_text(&self) -> Result<Option<ClipText>, Error> {
        let embedding = self.text_embedding.as_deref().map(read_embedding);
        let text = ClipText {
            caption: self.text.clone(),
            embedding: embedding.transpose()?,
        };
        Ok((text != ClipText::default()).then_some(text))
    }
}
