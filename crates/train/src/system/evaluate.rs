//! Preparation of evaluations.

use std::rc::Rc;

use burn::tensor::Device;

use super::Systems;
use crate::TrainedModel;
use crate::checkpoint::resolve_checkpoint;
use crate::clips::evaluator::{EvaluatorFiles, EvaluatorSource, TextMotionEvaluator};
use crate::error::Error;
use crate::evaluation::{
    Column, Evaluated, EvaluationRequest, OnStep, Prepared, furthest_from_real,
};
use crate::memory::must_fit;

impl Systems<'_> {
    /// The evaluation of a trained model, with the text-motion evaluator of the model's config.
    ///
    /// # Errors
    /// As [`System::evaluate`](super::System::evaluate). Fails if the evaluator cannot be opened.
    pub fn evaluate<'m>(
        self,
        trained: &'m TrainedModel,
        request: &EvaluationRequest,
    ) -> Result<Prepared<'m>, Error> {
        let (system, _) = self.of(trained.config())?;
        let evaluator = match system.evaluator_files(trained.config()) {
            Some(files) => self.text_motion_evaluator(files, &trained.device)?,
            None => None,
        };
        let request = EvaluationRequest {
            evaluator: evaluator.or_else(|| request.evaluator.clone()),
            ..request.clone()
        };
        request.must_be_accepted(system.accepts_in_evaluation(), trained)?;
        let evaluation = system.evaluate(trained, &request)?;
        let processes = request.group.ranks().local().size as u64;
        let memory = evaluation.memory.saturating_mul(processes);
        must_fit("the evaluation", memory, evaluation.memory_hint)?;
        let seed = request.seed;
        let report = evaluation.report;
        let evaluate = Box::new(move |on_step: &mut OnStep<'_>| {
            let precision = trained.config().sampling.precision.of_products();
            let results = precision.scope(|| (evaluation.measure)(on_step))?;
            let run = &trained.config().run.name;
            let (mut json, mut facts) = (results.json, results.facts);
            json["run"] = run.as_str().into();
            json["seed"] = seed.into();
            json["report"] = report.into();
            let config = serde_json::to_value(trained.config()).expect("plain data");
            json["evaluation"] = config["evaluation"].clone();
            if results.samples.is_some() {
                let step = trained.saved.state.step;
                json["step"] = step.into();
                facts.insert(0, ("step", [Some(step), None]));
            }
            let column = |side: usize, groups| Column {
                facts: facts.iter().map(|(name, of)| (*name, of[side])).collect(),
                groups,
            };
            let samples = column(0, results.samples.unwrap_or_else(|| results.real.clone()));
            let real = column(1, results.real);
            let mut verdict = results.verdict;
            verdict.extend(furthest_from_real(&samples, &real));
            json["verdict"] = verdict.clone().into();
            Ok(Evaluated {
                run: run.clone(),
                json,
                samples,
                real,
                verdict,
                remarks: [evaluation.remarks, results.remarks].concat(),
            })
        });
        Ok(Prepared { report, evaluate })
    }

    /// The evaluator of the table `evaluation.evaluator`; `None` if the table is empty.
    pub(super) fn text_motion_evaluator(
        self,
        files: &EvaluatorFiles,
        device: &Device,
    ) -> Result<Option<Rc<dyn TextMotionEvaluator>>, Error> {
        if !files.run.as_os_str().is_empty() {
            let saved = resolve_checkpoint(&files.run, |_| {})?;
            let (system, recipe) = self.of(&saved.state.config)?;
            let saved = system.read_tables(saved)?;
            let found = system.text_motion_evaluator(EvaluatorSource::Run(&saved), device)?;
            return found.map(Some).ok_or_else(|| {
                let message = format!(
                    "{} is of a run of recipe `{}`",
                    files.run.display(),
                    recipe.name
                );
                let hint = "`evaluation.evaluator.run` takes a run of recipe `text_motion`";
                Error::usage(message, hint)
            });
        }
        if files.has_files() {
            for system in self.0 {
                let source = EvaluatorSource::Files(files);
                if let Some(found) = system.text_motion_evaluator(source, device)? {
                    return Ok(Some(found));
                }
            }
            return Err(Error::usage(
                "`evaluation.evaluator` names files of a text-motion evaluator",
                "none of the systems of this program reads them: leave them out",
            ));
        }
        Ok(None)
    }
}
