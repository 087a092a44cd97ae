//! Shared by the systems of clips: captions, goals, paths, prompt files, the feature space, the
//! text-motion evaluator and the clips of a dataset.

pub mod captions;
pub mod evaluator;
mod goals;
mod loss;
pub mod path_condition;
pub mod path_target;
pub mod settings;
pub mod space;
mod text_plan;
pub mod training;

pub use goals::read_goal;
pub use loss::{ChannelWeights, clip_loss, weighted_masked_loss};
pub use path_target::{Followed, PathTarget};
pub use space::FeatureSpace;
pub use text_plan::TimedPrompt;

use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_data::{Alone, DataConfig, DataKind, Dataset, ValidationSplit};

use crate::TrainedModel;
use crate::error::Error;
use crate::sampling::{Request, SampleSink};

/// `own`, or the dataset of clips at `source`; the lists of the dataset define held-out clips.
pub(crate) fn dataset_or(own: &DataConfig, source: Option<&str>) -> DataConfig {
    match source {
        None => own.clone(),
        Some(source) => DataConfig {
            kind: DataKind::Humanml3d,
            source: Some(source.to_owned()),
            validation: ValidationSplit::default(),
            ..own.clone()
        },
    }
}

/// The clips whose ids match `pattern`, held-out clips first.
pub(crate) fn clips_named(dataset: &Dataset<Clip>, pattern: &str) -> Result<Vec<Arc<Clip>>, Error> {
    let mut chosen = Vec::new();
    for side in [&dataset.validation, &dataset.train] {
        let side = side.filter(|id| kinegrad_data::matches(pattern, id));
        chosen.extend(side.load()?);
    }
    if chosen.is_empty() {
        let message = format!("the dataset has no clip `{pattern}`");
        return Err(Error::usage(message, dataset.ids_hint()));
    }
    Ok(chosen)
}

/// Clips and their dataset.
pub type RequestedClips = (DataConfig, Vec<Arc<Clip>>);

/// The clips that a request names by id, or held-out clips, with their dataset.
///
/// # Errors
/// If no clip matches, or a clip cannot be read.
pub fn requested(
    trained: &TrainedModel,
    request: &Request,
    sink: &mut dyn SampleSink,
) -> Result<Option<RequestedClips>, Error> {
    let (item, held_out) = (request.item(), request.held_out_items());
    if item.is_none() && held_out.is_none() {
        return Ok(None);
    }
    let source = item.and_then(|(_, source)| source);
    let data = dataset_or(&trained.config().data, source);
    let dataset = Dataset::<Clip>::open_among(&data, &*sink.reading(), &Alone)?;
    let clips = match (item, held_out) {
        (Some((pattern, _)), _) => clips_named(&dataset, pattern)?,
        (None, count) => dataset.held_out().evenly(count.unwrap_or(0))?,
    };
    Ok(Some((data, clips)))
}
