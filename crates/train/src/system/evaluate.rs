//! Preparation of evaluations.

use super::System;
use crate::TrainedModel;
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest};

/// Validates the request and returns a function that evaluates a model of `system`.
///
/// # Errors
/// If the system does not accept an option of the request, without held-out items, or if memory is
/// short.
pub(super) fn prepare<'a>(
    system: &dyn System,
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.must_be_accepted(system.accepts_in_evaluation(), trained)?;
    let evaluation = system.evaluate(trained, request)?;
    request.must_fit(evaluation.memory, evaluation.memory_hint)?;
    let seed = request.seed;
    Ok(Box::new(move |on_step| {
        let results = (evaluation.measure)(on_step)?;
        let run = &trained.config().run.name;
        let (mut json, mut facts) = (results.json, results.facts);
        json["run"] = run.as_str().into();
        json["seed"] = seed.into();
        if results.samples.is_some() {
            let step = trained.saved.state.step;
            json["step"] = step.into();
            facts.insert(0, ("step", [Some(step), None]));
        }
        let column = |side: usize, groups| Column {
            facts: facts.iter().map(|(name, of)| (*name, of[side])).collect(),
            groups,
        };
        Ok(Evaluated {
            run: run.clone(),
            report: evaluation.report,
            json,
            samples: column(0, results.samples.unwrap_or_else(|| results.real.clone())),
            real: column(1, results.real),
            remarks: [evaluation.remarks, results.remarks].concat(),
        })
    }))
}
