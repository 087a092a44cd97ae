//! The start of training on clips: dataset, initial checkpoint, statistics and samples.

use std::path::Path;
use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::{Clip, ClipSamples, ClipSet};
use kinegrad_motion::Statistics;

use super::captions::TextInput;
use crate::config::Config;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::RunContext;
use crate::start::Start;
use crate::system::System;

/// Opens the dataset of the run and shows its warnings. Each rank reads a part. Collective.
///
/// # Errors
/// If the dataset cannot be opened, or differs from that of earlier steps.
pub fn open(context: &RunContext, observer: &mut dyn Observer) -> Result<Dataset<Clip>, Error> {
    let data = &context.config.data;
    let dataset = Dataset::open_among(data, &*observer.reading(), &*context.group)?;
    context.check_dataset(&dataset, observer)?;
    Ok(dataset)
}

/// The checkpoint `init` that a new run starts from; `None` for a resumed run.
///
/// # Errors
/// As [`Start::named`].
pub fn start_of(
    context: &RunContext,
    init: &Path,
    system: &dyn System,
) -> Result<Option<Start>, Error> {
    match &context.checkpoint {
        Some(_) => Ok(None),
        None => Start::named("init.diffusion", init, system),
    }
}

/// Rejects an initial checkpoint whose features or texts differ from those of `config`.
///
/// # Errors
/// Names the key of the initial checkpoint and the keys that differ.
pub fn must_fit_clips(start: &Start, config: &Config) -> Result<(), Error> {
    let found = &start.state().config.data.humanml3d;
    let given = &config.data.humanml3d;
    if (given.root, given.skeleton) != (found.root, found.skeleton) {
        let reason = "its clips have another `data.humanml3d.root` or `skeleton`";
        return Err(start.refused(&reason));
    }
    if given.text != found.text {
        return Err(start.refused(&"it was trained with another `data.humanml3d.text`"));
    }
    Ok(())
}

/// The statistics of the resumed run or of `start`, otherwise those of the training clips.
///
/// # Errors
/// [`Error::OtherRepresentation`] for statistics of other motion. Fails if a clip cannot be read.
pub fn statistics(
    context: &RunContext,
    start: Option<&Start>,
    dataset: &Dataset<Clip>,
    observer: &mut dyn Observer,
) -> Result<Statistics, Error> {
    let resumed = context.checkpoint.as_ref();
    let resumed = resumed.map(|checkpoint| &checkpoint.state);
    match resumed.or(start.map(Start::state)) {
        Some(state) => Ok(state.clip_statistics()?.clone()),
        None => Ok(dataset.statistics_among(&*observer.reading(), &*context.group)?),
    }
}

/// Samples of the first `channels` features of clips, with texts in the form of `text`.
pub fn samples(
    dataset: &Dataset<Clip>,
    statistics: &Statistics,
    channels: usize,
    text: TextInput,
) -> impl Fn(ClipSet, &Config) -> ClipSamples + 'static {
    let (representation, statistics) =
        (dataset.representation.clone(), Arc::new(statistics.clone()));
    move |clips, config| {
        let (data, seed) = (&config.data, config.run.seed);
        let (representation, statistics) = (representation.clone(), statistics.clone());
        let samples = ClipSamples::new(clips, representation, statistics, channels, data, seed);
        match text.labels() {
            Some(labels) => samples.with_labels(labels.clone()),
            None => samples,
        }
    }
}
