//! The clips of a dataset that a request is about.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_data::{DataConfig, DataKind, Dataset, ValidationSplit};

use crate::error::Error;
use crate::together::Together;

/// `own`, the dataset of a run on clips, or the one at `source` in its place, whose own lists say what
/// is held out.
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

/// The dataset of an evaluation of `checkpoint`, some of whose clips are held out; `purpose` says what
/// they are for. Ranks read a part each. Collective.
///
/// # Errors
/// [`Error::Usage`] if none is held out; if the dataset cannot be opened.
pub(crate) fn with_held_out(
    data: &DataConfig,
    checkpoint: &Path,
    purpose: &str,
    together: &Together,
) -> Result<Dataset<Clip>, Error> {
    let unheard = |_, _| ControlFlow::Continue(());
    let dataset = Dataset::<Clip>::open_among(data, &unheard, together)?;
    if dataset.validation.is_empty() {
        let message = format!("no clip is held out for {}", checkpoint.display());
        let hint = format!("{purpose}: give a dataset that holds out some with `--source URI`");
        return Err(Error::usage(message, hint));
    }
    Ok(dataset)
}

/// The clips whose ids match `pattern`, those held out first.
///
/// # Errors
/// [`Error::Usage`] if there are none; if one cannot be read.
pub(crate) fn clips_named(dataset: &Dataset<Clip>, pattern: &str) -> Result<Vec<Arc<Clip>>, Error> {
    let mut chosen = Vec::new();
    for side in [&dataset.validation, &dataset.train] {
        let side = side.filter(|id| kinegrad_data::matches(pattern, id));
        chosen.extend(side.load()?);
    }
    if chosen.is_empty() {
        let message = format!("the dataset has no clip `{pattern}`");
        let hint = "`kinegrad data inspect URI` lists the clips";
        return Err(Error::usage(message, hint));
    }
    Ok(chosen)
}
