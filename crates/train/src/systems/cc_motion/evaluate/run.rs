//! The evaluation of a trained model on its held-out phrases.

use kinegrad_data::{DataKind, Dataset, Phrase};

use super::report::evaluated;
use super::{EvaluationSettings, evaluate};
use crate::config::SystemTables;
use crate::error::Error;
use crate::evaluation::{Evaluate, EvaluationRequest};
use crate::memory::must_fit;
use crate::sampling::Subject;
use crate::systems::cc_motion::CcMotionConfig;
use crate::systems::cc_motion::generate::{self, Generator};
use crate::systems::cc_motion::lengths::untrained;

/// Bytes of memory that a frame of a sample takes: the raw motion and the post-processed one, and
/// the differences that are measured of each.
const BYTES_A_FRAME: u64 = 800;

/// An evaluation on the held-out phrases.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub fn prepare<'a>(
    subject: &'a Subject,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    if request.trajectory.is_some() {
        let message = format!(
            "`--trajectory-run` with {}, a run on phrases",
            subject.checkpoint.display()
        );
        let hint = "only models that follow goals take a path from a first stage";
        return Err(Error::usage(message, hint));
    }
    let wanted = CcMotionConfig::of(&subject.config)?.evaluation;
    let mut data = subject.config.data.clone();
    if let Some(source) = &request.source {
        data.kind = DataKind::Phrases;
        data.source = Some(source.clone());
    }
    let dataset = Dataset::<Phrase>::open(&data)?;
    if dataset.validation.is_empty() {
        let message = format!(
            "no phrase is held out for {}: all {} are trained on",
            subject.checkpoint.display(),
            dataset.train.len()
        );
        let hint = "its config's `data.validation` holds out none of them; give a dataset that it \
                    does with `--source URI`, or train with another `data.validation`";
        return Err(Error::usage(message, hint));
    }
    let mut held_out = dataset.validation.load()?;
    held_out.truncate(wanted.phrases.unwrap_or(usize::MAX));
    let frames = held_out.iter().map(|phrase| phrase.frames() as u64);
    let of_a_seed = frames.sum::<u64>() * BYTES_A_FRAME;
    must_fit(
        "the evaluation",
        of_a_seed.saturating_mul(wanted.seeds as u64),
        "all samples are compared with each other: choose fewer `evaluation.seeds` or \
         `evaluation.phrases`",
    )?;
    let longest = held_out.iter().map(|phrase| phrase.frames()).max();
    let hint = "choose fewer `evaluation.seeds`: the samples of a phrase are drawn at a time";
    generate::must_fit(subject, wanted.seeds, longest.unwrap_or_default(), hint)?;
    let settings = EvaluationSettings {
        seeds: wanted.seeds,
        seed: request.seed,
        cond: wanted.cond,
        sampling: subject.config.sampling.clone(),
    };
    let training = dataset.train.load()?;
    let lengths = held_out.iter().map(|phrase| phrase.frames());
    let odd = untrained(&subject.config.data, lengths);
    Ok(Box::new(move |on_step| {
        let generator = Generator::load(&subject.checkpoint, subject.weights, &subject.device)?;
        let mut told = |done, all| on_step("", done, all);
        let evaluation = evaluate(&generator, &held_out, &training, &settings, &mut told)?;
        let mut evaluated = evaluated(&evaluation);
        if generator.statistics().movement.is_empty() {
            evaluated.remarks.push(format!(
                "{} was trained before kinegrad measured how training motion moves: the bounds of \
                 `strict` are those of its dataset's {} training phrases",
                evaluation.run,
                training.len()
            ));
        }
        evaluated.remarks.extend(odd);
        Ok(evaluated)
    }))
}
