//! Evaluating trained models: requests, and results that reports show side by side.

use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;

use serde_json::Value;

use crate::checkpoint::SavedCheckpoint;
use crate::clips::evaluator::TextMotionEvaluator;
use crate::error::Error;
use crate::memory::must_fit;
use crate::together::Together;

/// What is measured, beside what the system's own tables say of it. A system refuses what does not
/// apply to its models.
#[derive(Clone, Debug, Default)]
pub struct EvaluationRequest {
    /// Dataset whose held-out items are used, instead of the run's own.
    pub source: Option<String>,
    /// Checkpoint of the trajectory model for two-stage sampling.
    pub trajectory: Option<SavedCheckpoint>,
    /// The text-motion evaluator that the run's config names, which
    /// [`Systems::evaluate`](crate::systems::Systems::evaluate) opens.
    pub evaluator: Option<Rc<dyn TextMotionEvaluator>>,
    /// Seed of the noise.
    pub seed: u64,
    /// Whether models that hear music are held against music that says something else.
    pub listening: bool,
    /// The processes that draw a part of the samples each; all of them find the same.
    pub together: Rc<Together>,
}

impl EvaluationRequest {
    /// Rejects an evaluation that takes so many bytes of main memory of each process of a machine.
    ///
    /// # Errors
    /// As [`must_fit`].
    pub(crate) fn must_fit(&self, needed: u64, hint: &str) -> Result<(), Error> {
        let processes = self.together.ranks().local().size as u64;
        must_fit("the evaluation", needed.saturating_mul(processes), hint)
    }

    /// Rejects options that are set but listed in `unknown`, by their command-line names, for a run
    /// that is `what`.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first that is set.
    pub(crate) fn refuse(
        &self,
        unknown: &[&str],
        checkpoint: &Path,
        what: &str,
        hint: &str,
    ) -> Result<(), Error> {
        let given = [
            ("--audio-ablation", self.listening),
            ("--trajectory-run", self.trajectory.is_some()),
        ];
        let mut given = given.into_iter();
        match given.find(|(name, given)| *given && unknown.contains(name)) {
            Some((name, _)) => {
                let message = format!("`{name}` with {}, {what}", checkpoint.display());
                Err(Error::usage(message, hint))
            }
            None => Ok(()),
        }
    }
}

/// A validated evaluation, to be called with a progress callback.
pub type Evaluate<'a> = Box<dyn FnOnce(&mut OnStep<'_>) -> Result<Evaluated, Error> + 'a>;

/// Progress callback: stage, denoising steps done and in total. `Break` ends with
/// [`Error::Interrupted`].
pub type OnStep<'a> = dyn FnMut(&'static str, usize, usize) -> ControlFlow<()> + 'a;

/// Results of the evaluation of one run.
#[derive(Clone, Debug)]
pub struct Evaluated {
    /// Name of the run.
    pub run: String,
    /// Stem of the report's files.
    pub report: &'static str,
    /// Everything, as JSON.
    pub json: Value,
    /// The metrics of the generated samples.
    pub drawn: Column,
    /// The same numbers of real motion.
    pub real: Column,
    /// What does not fit into columns.
    pub remarks: Vec<String>,
}

/// Numbers of one set of motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Counts and the like by name; nothing where one does not apply.
    pub facts: Vec<(&'static str, Option<u64>)>,
    /// The numbers, in groups.
    pub groups: Vec<Group>,
}

/// Numbers that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its name in files.
    pub key: &'static str,
    /// Its heading in tables; empty where there is only one.
    pub title: &'static str,
    /// The numbers.
    pub numbers: Vec<Number>,
}

/// A number.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Its name in files.
    pub name: String,
    /// Nothing where it cannot be computed.
    pub value: Option<f64>,
    /// Its line in tables, a title and the number as text; nothing where files alone have it.
    pub line: Option<(String, Option<String>)>,
}
