//! Samplers: resolved requests.

use std::borrow::Cow;
use std::rc::Rc;

use kinegrad_data::humanml::{Caption, Clip};
use kinegrad_motion::humanml::Features;
use kinegrad_motion::metrics::text_motion::Token;
use kinegrad_motion::path::PathReport;

use super::{
    Condition, Generated, MeasuresRecord, Names, PathRecord, Record, Request, Sample, SampleSink,
    Selection, Summary, item_seed,
};
use crate::TrainedModel;
use crate::clips::evaluator::TextMotionEvaluator;
use crate::error::Error;

/// Share of its path that a motion travels at least, without a warning.
const LEAST_PROGRESS: f64 = 0.7;

/// Samples of one condition.
#[derive(Clone, Debug)]
pub struct Job {
    /// The condition in file names; `None` for a single one.
    pub name: Option<String>,
    /// The resolved conditions, for the record.
    pub conditions: Vec<Condition>,
    /// The caption of an item.
    pub caption: Option<Caption>,
    /// Frames of a sample.
    pub frames: usize,
}

impl Job {
    /// A job for a clip of the dataset at `source`, with more conditions.
    pub fn of_clip(
        clip: &Clip,
        source: Option<String>,
        others: &[Condition],
        frames: usize,
    ) -> Self {
        let id = clip.id.clone();
        let item = Condition::Item { id, source };
        Self {
            name: Some(clip.id.clone()),
            conditions: [&[item][..], others].concat(),
            caption: clip.caption().cloned(),
            frames,
        }
    }

    /// The caption of its item, or its text.
    pub(crate) fn text(&self) -> Option<Cow<'_, Caption>> {
        let text = self
            .conditions
            .iter()
            .find_map(|condition| match condition {
                Condition::Text { text, .. } => Some(text),
                _ => None,
            });
        let own = self.caption.as_ref().map(Cow::Borrowed);
        own.or_else(|| {
            Some(Cow::Owned(Caption {
                text: text?.clone(),
                ..Caption::default()
            }))
        })
    }

    /// The seed of the job's noise, which depends on the item that names the job.
    pub fn seed(&self, seed: u64) -> u64 {
        let id = self.name.as_deref();
        id.map_or(seed, |id| item_seed(seed, id))
    }
}

/// Memory for sampling.
#[derive(Clone, Debug)]
pub struct Needs {
    /// The work, such as `sampling 4 clips of 60 frames`.
    pub work: String,
    /// Bytes of main memory.
    pub bytes: u64,
    /// The hint of the error if memory is short.
    pub hint: &'static str,
}

/// A request resolved by a system: the conditions have been read and fit the model.
pub trait Sampler {
    /// The jobs, in the order of their samples.
    fn jobs(&self) -> &[Job];

    /// Extensions of the files of a sample, the motion first.
    fn extensions(&self) -> &'static [&'static str];

    /// True if the samples of all jobs are one batch with consecutive numbers.
    fn is_one_batch(&self) -> bool {
        false
    }

    /// The memory for each part of sampling.
    ///
    /// # Errors
    /// If a network cannot be built.
    fn needs(&self) -> Result<Vec<Needs>, Error> {
        Ok(Vec::new())
    }

    /// Loads the model, generates all samples and passes each to `run`. Returns a summary.
    ///
    /// # Errors
    /// If the checkpoint cannot be read, a sample is not finite, or the sink fails.
    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error>;
}

/// A run of a sampler: the request and the sink of samples.
pub struct Run<'a> {
    /// The trained model.
    pub trained: &'a TrainedModel,
    /// The request, with its length in frames.
    pub request: &'a Request,
    /// The receiver of samples, notes and progress.
    pub sink: &'a mut dyn SampleSink,
    pub(crate) system: &'static str,
    pub(crate) fps: f64,
    pub(crate) jobs: &'a [Job],
    pub(crate) names: Names,
    pub(crate) is_one_batch: bool,
    /// Samples that are kept of each job.
    pub(crate) kept: usize,
    /// The best sample of each job so far.
    pub(crate) selections: Vec<Selection>,
    /// The measure of samples by their texts, if samples are selected by it.
    pub(crate) text_match: Option<TextMatch>,
    /// Distances from paths, one line per sample.
    pub(crate) paths: Vec<String>,
    /// The measures of the bodies among the samples.
    pub(crate) bodies: Vec<MeasuresRecord>,
}

/// A text-motion evaluator and the embeddings of the jobs' texts.
pub(crate) struct TextMatch {
    evaluator: Rc<dyn TextMotionEvaluator>,
    texts: Vec<Vec<f64>>,
}

impl TextMatch {
    /// The texts of `jobs`; `None` if a job has none.
    pub fn of(evaluator: Rc<dyn TextMotionEvaluator>, jobs: &[Job]) -> Option<Self> {
        let captions: Vec<Cow<Caption>> = jobs.iter().map(Job::text).collect::<Option<_>>()?;
        let words: Vec<_> = captions.iter().map(|caption| caption.words()).collect();
        let words: Vec<&[Token]> = words.iter().map(AsRef::as_ref).collect();
        let texts = evaluator.text_embeddings(&words);
        Some(Self { evaluator, texts })
    }

    /// Distance between the embeddings of a job's text and a motion.
    fn distance(&self, job: usize, motion: &Features) -> Result<f64, Error> {
        let found = self.evaluator.motion_embeddings(&[motion])?;
        let pairs = self.texts[job].iter().zip(&found[0]);
        let squares = pairs.map(|(text, motion)| (text - motion).powi(2));
        Ok(squares.sum::<f64>().sqrt())
    }
}

impl Run<'_> {
    /// The name of a sample of a job; of samples of which one is kept, its name.
    pub fn name(&self, job: usize, index: usize) -> String {
        let index = if self.request.best_of.is_some() {
            0
        } else {
            index
        };
        match self.is_one_batch {
            true => self.names.of("", job * self.kept + index),
            false => self.names.of(&self.names.stems[job], index),
        }
    }

    /// The record of a sample of a job. The sampler fills in the fields of its system.
    pub fn record(&self, job: usize, index: usize) -> Record {
        let Job {
            conditions, frames, ..
        } = &self.jobs[job];
        let before = usize::from(self.is_one_batch) * job * self.request.count;
        Record {
            index: before + index,
            frames: *frames,
            fps: self.fps,
            condition: conditions.clone(),
            ..Record::new(self.system, self.trained, self.request.seed)
        }
    }

    /// The name of a sample in messages.
    pub fn title(&self, job: usize, index: usize) -> String {
        match self.name(job, index) {
            name if name.is_empty() => "the sample".to_owned(),
            name => format!("sample {}", name.trim_start_matches('-')),
        }
    }

    /// Passes a sample to the sink, or the best one after the last sample of its job. A body or phrase
    /// is measured, and a warning names what is out of the bounds of the training motion.
    ///
    /// # Errors
    /// If the sample cannot be stored.
    pub fn pass(
        &mut self,
        job: usize,
        index: usize,
        generated: Generated,
        mut record: Record,
    ) -> Result<(), Error> {
        let statistics = &self.trained.saved.state.statistics;
        match &generated {
            Generated::Clip {
                joints, skeleton, ..
            } => record.body = Some(MeasuresRecord::of(joints, skeleton, statistics)),
            Generated::Phrase { motion, .. } => {
                record.phrase = Some(MeasuresRecord::of_phrase(motion, statistics));
            }
            _ => {}
        }
        if let (Some(text_match), Generated::Clip { features, .. }) = (&self.text_match, &generated)
            && let Some(features) = features
        {
            record.text_distance = Some(text_match.distance(job, features)?);
        }
        let mut sample = match &self.request.best_of {
            Some(best_of) => match self.selections[job].add(best_of, generated, record) {
                Some(best) => best,
                None => return Ok(()),
            },
            None => Sample {
                name: String::new(),
                files: generated.files(),
                record,
            },
        };
        sample.name = self.name(job, index);
        let (title, record) = (self.title(job, index), &sample.record);
        if let Some(selection) = &record.selection {
            self.sink.note(&selection.line(&title));
        }
        if let Some(warning) = record
            .ground
            .as_ref()
            .and_then(|ground| ground.warning(&title))
        {
            self.sink.warning(&warning);
        }
        if let Some(PathRecord { report, .. }) = &record.path {
            self.paths.push(deviation(report));
            if report.travelled < LEAST_PROGRESS * report.asked {
                self.sink.warning(&format!(
                    "{title} travels {:.2} of {:.2} m along the path: give it more time, or see \
                     docs/paths.md for another `method`",
                    report.travelled, report.asked
                ));
            }
        }
        let body = record.body.clone();
        // A table lists the checks of held-out phrases.
        let phrase = record.phrase.clone();
        let phrase = phrase.filter(|_| self.request.held_out_items().is_none());
        self.sink.sample(sample)?;
        let measured = [&body, &phrase].into_iter().flatten();
        for warning in measured.filter_map(|measured| measured.warning(&title)) {
            self.sink.warning(&warning);
        }
        self.bodies.extend(body);
        Ok(())
    }
}

/// A description of how a motion follows its path, and of its body.
fn deviation(report: &PathReport) -> String {
    let mut text = format!(
        "travelled {:.2} of {:.2} m; {:.3} m from the path, at most {:.3} m; {:.2} m from its place in \
         time, at most {:.2} m",
        report.travelled,
        report.asked,
        report.mean_distance,
        report.largest_distance,
        report.mean_error,
        report.largest_error
    );
    let heading = report.heading_error;
    text.extend(heading.map(|degrees| format!("; heading {degrees:.0} degrees from it")));
    for (name, value, digits) in report.body.rows() {
        text.extend(value.map(|value| format!("; {name} {value:.digits$}")));
    }
    text
}
