//! Which clips a dataset holds, and what comes with them.

use std::sync::Arc;

use crate::files::Files;
use crate::listing::{Expected, Listed, ids};
use crate::split::Split;
use crate::store::Store;
use crate::survey::{Listable, Survey};
use crate::{DataConfig, DataKind, Error, StoreError};

use super::clip::ClipFiles;
use super::embeddings::{self, Embeddings};
use super::lists::read_lists;
use super::synthetic::Walks;
use super::{CaptionRule, Clip, statistics, synthetic_id};

impl Listable for Clip {
    fn survey(config: &DataConfig) -> Result<Survey<Self>, Error> {
        match config.kind {
            DataKind::Humanml3d => files(config),
            DataKind::SyntheticWalks => made_up(config),
            kind @ (DataKind::Phrases | DataKind::Synthetic) => Err(Error::wrong_kind(
                kind,
                "\"humanml3d\" or \"synthetic_walks\"",
                "phrases are not clips: use a recipe or command for phrases",
            )),
        }
    }
}

/// Walks, which the rule of the config divides.
fn made_up(config: &DataConfig) -> Result<Survey<Clip>, Error> {
    let conditional = !config.humanml3d.text_embeddings.is_empty();
    let split = Split::new(&config.validation)?;
    let mut listed = Listed::made_up(config.synthetic.phrases, synthetic_id);
    listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
    Ok(Survey {
        representation: config.humanml3d.representation(),
        given: None,
        warnings: split.idle_entries(ids(&listed)),
        split: Some(split),
        origin: Box::new(Walks::new(config, conditional)),
        counters: Arc::default(),
        source: "synthetic_walks".to_owned(),
        listed,
        concurrency: 0,
        tolerates_changes: false,
    })
}

/// Clips in files, which the dataset's lists divide.
fn files(config: &DataConfig) -> Result<Survey<Clip>, Error> {
    let humanml3d = &config.humanml3d;
    let mut warnings = Vec::new();
    let source = config.source.as_deref().unwrap_or_default();
    let store = Store::open(source, &config.store)?;
    let files = Files::open(store, config, &mut warnings)?;
    let mut listed = read_lists(&files, humanml3d, &mut warnings)?;
    listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
    let representation = humanml3d.representation();
    let given = statistics::given(&files, &representation)?;
    let embeddings = read_embeddings(&files, &humanml3d.text_embeddings, &mut warnings)?;
    let fingerprint = given.as_ref().map(|given| {
        let [mean, std] = given.digests;
        format!("{mean}{std}")
    });
    Ok(Survey {
        split: None,
        warnings,
        counters: files.store.counters().clone(),
        source: files.store.uri(),
        listed,
        concurrency: files.concurrency(config),
        tolerates_changes: false,
        origin: Box::new(ClipFiles {
            files,
            skeleton: representation.skeleton.clone(),
            captions_required: match humanml3d.captions {
                Some(rule) => rule == CaptionRule::Required,
                None => embeddings.is_some(),
            },
            embeddings,
            min_frames: humanml3d.min_frames,
            max_frames: humanml3d.max_frames,
            fingerprint: fingerprint.unwrap_or_default(),
        }),
        given: given.map(|given| given.statistics),
        representation,
    })
}

fn read_embeddings(
    files: &Files,
    path: &str,
    warnings: &mut Vec<String>,
) -> Result<Option<Embeddings>, Error> {
    if path.is_empty() {
        return Ok(None);
    }
    let unknown = Expected::Version(String::new());
    match files.read(path, &unknown, embeddings::MAX_BYTES, "") {
        Ok((bytes, digest)) => {
            let name = files.store.name_of(path);
            Ok(Some(Embeddings::parse(&bytes, &name, digest)?))
        }
        Err(StoreError::Missing { object }) => {
            warnings.push(format!(
                "{object}: not found; clips have no condition (docs/dataset.md shows how to make \
                 the file; data.humanml3d.text_embeddings = \"\" says that none is wanted)"
            ));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
#[path = "survey_tests.rs"]
mod tests;
