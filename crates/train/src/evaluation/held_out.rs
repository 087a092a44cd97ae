//! The held-out items of an evaluation.

use kinegrad_data::humanml::Clip;
use kinegrad_data::{DataConfig, DataKind, Dataset, Item, PhraseItem, no_progress};
use kinegrad_settings::counted;

use super::EvaluationRequest;
use crate::TrainedModel;
use crate::clips::dataset_or;
use crate::error::Error;

/// The clips of an evaluation and their config: `own`, or the config of the request's dataset.
/// `purpose` is a clause for the error's hint. Each process reads a part. Collective.
///
/// # Errors
/// [`Error::Usage`] without held-out clips. Fails if the dataset cannot be opened.
pub fn clips_with_held_out(
    own: &DataConfig,
    trained: &TrainedModel,
    request: &EvaluationRequest,
    purpose: &str,
) -> Result<(DataConfig, Dataset<Clip>), Error> {
    let data = dataset_or(own, request.source.as_deref());
    let dataset = Dataset::open_among(&data, &no_progress, &*request.group)?;
    Ok((data, must_hold_out(dataset, trained, purpose)?))
}

/// [`clips_with_held_out`] for phrases; `data.validation` also splits the request's dataset.
///
/// # Errors
/// As [`clips_with_held_out`].
pub fn phrases_with_held_out(
    trained: &TrainedModel,
    request: &EvaluationRequest,
    purpose: &str,
) -> Result<(DataConfig, Dataset<PhraseItem>), Error> {
    let mut data = trained.config().data.clone();
    if let Some(source) = &request.source {
        data.kind = DataKind::Phrases;
        data.source = Some(source.clone());
    }
    let dataset = Dataset::open_among(&data, &no_progress, &*request.group)?;
    Ok((data, must_hold_out(dataset, trained, purpose)?))
}

fn must_hold_out<T: Item>(
    dataset: Dataset<T>,
    trained: &TrainedModel,
    purpose: &str,
) -> Result<Dataset<T>, Error> {
    if !dataset.validation.is_empty() {
        return Ok(dataset);
    }
    let message = format!(
        "no {} is held out for {}: all {} are trained on",
        T::KIND,
        trained.path().display(),
        dataset.train.len()
    );
    let hint = format!(
        "{purpose}: give a dataset that holds out some with option `source URI`, or train with another \
         `data.validation`"
    );
    Err(Error::usage(message, hint))
}

/// A note if fewer clips are held out (`found`) than `wanted` goals or rollouts, called `name`.
pub fn note_if_fewer(
    found: usize,
    wanted: usize,
    name: &str,
    trained: &TrainedModel,
) -> Option<String> {
    let path = trained.path().display();
    let clips = counted(found, "clip");
    (found < wanted)
        .then(|| format!("note: {clips} held out for {path}, fewer than {wanted} {name}"))
}
