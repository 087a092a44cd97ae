//! Evaluation of trained models on held-out motion: requests, reports and tables of all systems.

mod held_out;
mod replications;
mod request;
mod table;
mod verdict;

use std::ops::ControlFlow;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, to_value};

pub use held_out::{clips_with_held_out, note_if_fewer, phrases_with_held_out};
pub use replications::{Replicated, replicate};
pub use request::EvaluationRequest;
pub use table::{Better, Column, Group, Metrics, Number};
pub(crate) use verdict::furthest_from_real;
pub use verdict::{best_columns, best_places};

use crate::config::SamplingConfig;
use crate::error::Error;
use crate::process_group::ProcessGroup;

/// Progress callback with stage, steps done and total steps. `Break` ends the evaluation with
/// [`Error::Interrupted`].
pub type OnStep<'a> = dyn FnMut(&'static str, usize, usize) -> ControlFlow<()> + 'a;

/// Generates and measures samples, with a progress callback.
pub type Evaluate<'a> = Box<dyn FnOnce(&mut OnStep<'_>) -> Result<Evaluated, Error> + 'a>;

/// A validated evaluation.
pub struct Prepared<'a> {
    /// Stem of the report's files.
    pub report: &'static str,
    /// The evaluation.
    pub evaluate: Evaluate<'a>,
}

/// Generates and measures the samples of an evaluation.
pub type Measure<'a> = Box<dyn FnOnce(&mut OnStep<'_>) -> Result<Results, Error> + 'a>;

/// A system's part of an evaluation.
pub struct Evaluation<'a> {
    /// Stem of the report's files.
    pub report: &'static str,
    /// Approximate main memory of each process, bytes; 0 for little.
    pub memory: u64,
    /// Hint of the error if memory is short.
    pub memory_hint: &'static str,
    /// Remarks on the request.
    pub remarks: Vec<String>,
    /// Generates and measures the samples.
    pub measure: Measure<'a>,
}

/// The numbers of an evaluation.
pub struct Results {
    /// The report without run, seed and step: a JSON object.
    pub json: Value,
    /// Counts of the samples and of real motion, by name; `None` if not applicable.
    pub facts: Vec<(&'static str, [Option<u64>; 2])>,
    /// The metrics of the samples; `None` for a model that does not generate motion.
    pub samples: Option<Vec<Group>>,
    /// The metrics of real motion.
    pub real: Vec<Group>,
    /// The system's verdict on the samples, in sentences.
    pub verdict: Vec<String>,
    /// Remarks outside the table.
    pub remarks: Vec<String>,
}

/// Results of the evaluation of one run.
#[derive(Clone, Debug)]
pub struct Evaluated {
    /// Name of the run.
    pub run: String,
    /// The report, as JSON.
    pub json: Value,
    /// The metrics of the samples.
    pub samples: Column,
    /// The same metrics of real motion.
    pub real: Column,
    /// The verdict on the samples, in sentences.
    pub verdict: Vec<String>,
    /// Remarks outside the table.
    pub remarks: Vec<String>,
}

/// The results of `item` for `count` items, shared among the processes; `item` gets a number and a
/// progress callback. Collective.
///
/// # Errors
/// The first error of `item`.
pub fn for_each_item<T: Serialize + DeserializeOwned>(
    group: &ProcessGroup,
    count: usize,
    on_step: &mut OnStep<'_>,
    mut item: impl FnMut(usize, &mut OnStep<'_>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    group.each(count, |number| {
        let [before, own] = group.own_of(number, count);
        item(number, &mut |stage, done, all| {
            on_step(stage, before * all + done, own * all)
        })
    })
}

/// Adds the keys of the sampling settings to `json`, an object.
pub fn with_sampling(mut json: Value, sampling: &SamplingConfig) -> Value {
    let settings = to_value(sampling).expect("plain data");
    let settings = settings.as_object().expect("a table").clone();
    json.as_object_mut().expect("an object").extend(settings);
    json
}
