//! The evaluation of a trained model on its held-out phrases.

use kinegrad_data::{DataKind, Dataset, Phrase};

use super::report::evaluated;
use super::{CondSource, EvaluationSettings, evaluate};
use crate::error::Error;
use crate::evaluation::{Evaluate, EvaluationRequest};
use crate::sampling::Subject;
use crate::systems::cc_motion::generate::Generator;

/// An evaluation that draws for the held-out phrases and measures.
///
/// # Errors
/// If what is asked for does not apply, or nothing is held out.
pub fn prepare<'a>(
    subject: &'a Subject,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    for (name, value, hint) in [
        (
            "--seeds",
            request.seeds,
            "draw at least one sample for each phrase; 2 tell how much two of them differ",
        ),
        (
            "--phrases",
            request.items,
            "ask for at least one phrase, or leave it out for all that are held out",
        ),
    ] {
        if value == Some(0) {
            return Err(Error::usage(format!("`{name}` is 0"), hint));
        }
    }
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
    held_out.truncate(request.items.unwrap_or(usize::MAX));
    let settings = EvaluationSettings {
        seeds: request.seeds.unwrap_or(2),
        seed: request.seed,
        cond: match request.noise {
            Some(true) => CondSource::Noise,
            _ => CondSource::Phrases,
        },
        sampling: subject.config.sampling.clone(),
    };
    let training = dataset.train.load()?;
    Ok(Box::new(move |on_step| {
        let generator = Generator::load(&subject.checkpoint, subject.weights, &subject.device)?;
        let mut told = |done, all| on_step("", done, all);
        let evaluation = evaluate(&generator, &held_out, &training, &settings, &mut told)?;
        Ok(evaluated(&evaluation))
    }))
}
