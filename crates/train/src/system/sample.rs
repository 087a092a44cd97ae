//! Sampling from requests.

use std::rc::Rc;

use kinegrad_output::cell;
use kinegrad_settings::counted;

use super::{System, Systems};
use crate::TrainedModel;
use crate::clips::evaluator::TextMotionEvaluator;
use crate::error::Error;
use crate::memory::must_fit;
use crate::sampling::{
    Job, MeasuresRecord, Names, Request, Run, SampleSink, Sampler, SelectBy, Selection, Summary,
    TextMatch,
};

impl Systems<'_> {
    /// Generates motion with the model `trained` and passes each sample, with its
    /// [`Record`](crate::sampling::Record), to `sink`. Returns a summary of all samples.
    ///
    /// # Errors
    /// If the request is contradictory, a condition is not accepted or cannot be read, or the sink
    /// fails; [`Error::Interrupted`] if the sink requests a stop.
    pub fn sample(
        self,
        trained: &TrainedModel,
        request: &Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Option<Summary>, Error> {
        request.validate()?;
        let (system, recipe) = self.of(trained.config())?;
        let request = request.at(system.fps(trained.config()))?;
        must_accept(system, recipe.name, &request)?;
        // All candidates are generated, and one is named and kept.
        let kept = request.count;
        let count = request
            .best_of
            .as_ref()
            .map_or(kept, |best_of| best_of.count);
        let request = Request { count, ..request };
        let sampler = system.sampler(trained, &request, sink)?;
        let mut text_match = None;
        if let Some(best_of) = &request.best_of {
            best_of.must_suit(&*sampler, &request)?;
            if best_of.by.contains(&SelectBy::Text) {
                let evaluator = self.evaluator_of(system, trained)?;
                text_match = TextMatch::of(evaluator, sampler.jobs());
            }
        }
        for needs in sampler.needs()? {
            must_fit(&needs.work, needs.bytes, needs.hint)?;
        }
        let names = names(&*sampler, &request, kept);
        if request.held_out_items().is_none() {
            sink.reserve_outputs(&names, sampler.extensions())?;
        }
        let mut run = Run {
            trained,
            request: &request,
            sink,
            system: system.name(),
            fps: system.fps(trained.config()),
            jobs: sampler.jobs(),
            names,
            is_one_batch: sampler.is_one_batch(),
            kept,
            selections: vec![Selection::default(); sampler.jobs().len()],
            text_match,
            paths: Vec::new(),
            bodies: Vec::new(),
        };
        let precision = trained.config().sampling.precision.of_products();
        let summary = precision.scope(|| sampler.sample(&mut run))?;
        if let Some(line) = MeasuresRecord::line(&run.bodies) {
            run.sink
                .note(&format!("{}: {line}", counted(run.bodies.len(), "sample")));
        }
        Ok(match run.paths.is_empty() {
            true => summary,
            false => {
                let lines = run.paths.iter().map(|path| cell(path));
                Some(Summary::Text(lines.collect::<Vec<_>>().join("\n")))
            }
        })
    }
}

impl Systems<'_> {
    /// The text-motion evaluator of a model, by which samples are selected.
    fn evaluator_of(
        self,
        system: &dyn System,
        trained: &TrainedModel,
    ) -> Result<Rc<dyn TextMotionEvaluator>, Error> {
        let config = trained.config();
        let problem = "option `select_by` is `text`";
        let Some(files) = system.evaluator_files(config) else {
            let recipe = &config.train.recipe;
            return Err(Error::usage(
                format!("{problem}, and models of recipe `{recipe}` have no text-motion evaluator"),
                "select by another measure",
            ));
        };
        let evaluator = self.text_motion_evaluator(files, &trained.device)?;
        evaluator.ok_or_else(|| {
            Error::usage(
                format!("{problem}, and no text-motion evaluator is configured"),
                "name a run of recipe `text_motion`: option `set evaluation.evaluator.run=RUN`",
            )
        })
    }
}

/// Rejects conditions and post-processing that the recipe does not accept.
fn must_accept(system: &dyn System, recipe: &str, request: &Request) -> Result<(), Error> {
    let accepted = system.accepts(recipe);
    if accepted.is_empty() {
        return Err(Error::usage(
            format!("recipe `{recipe}` generates nothing"),
            "sample a run of another recipe",
        ));
    }
    let given = request.conditions.iter().map(|condition| condition.name());
    let post_processing = request.post_processing.map(|_| "postprocess");
    let mut given = given.chain(post_processing);
    match given.find(|name| !accepted.contains(name)) {
        None => Ok(()),
        Some(name) => {
            let accepted: Vec<String> = accepted
                .iter()
                .filter(|name| **name != "held_out")
                .map(|name| format!("option `{name}`"))
                .collect();
            Err(Error::usage(
                format!("option `{name}` with a run of recipe `{recipe}`"),
                format!("it accepts {}", accepted.join(", ")),
            ))
        }
    }
}

/// Names of the samples; a sample for a held-out item has the item's id.
/// `count` samples of each job are kept.
fn names(sampler: &dyn Sampler, request: &Request, count: usize) -> Names {
    let (jobs, held_out) = (sampler.jobs(), request.held_out_items().is_some());
    if sampler.is_one_batch() {
        return Names {
            stems: vec![String::new()],
            count: jobs.len() * count,
        };
    }
    let stem = |(number, job): (usize, &Job)| match &job.name {
        Some(name) if held_out => name.clone(),
        None if held_out => format!("{number:03}"),
        Some(name) if jobs.len() > 1 => format!("-{name}"),
        _ => String::new(),
    };
    Names {
        stems: jobs.iter().enumerate().map(stem).collect(),
        count,
    }
}
