//! The clips of a dataset, their statistics and embeddings.

use crate::file::MAX_TENSOR_BYTES;
use crate::files::Files;
use crate::listing::{Listed, ids};
use crate::scan::{Listable, Scan};
use crate::split::Split;
use crate::store::Store;
use crate::{DataConfig, DataKind, Error};

use super::clip::ClipFiles;
use super::embeddings::Embeddings;
use super::lists::read_lists;
use super::synthetic::Walks;
use super::{CaptionRule, CaptionText, Clip, statistics, synthetic_id};

impl Listable for Clip {
    fn scan(config: &DataConfig) -> Result<Scan<Self>, Error> {
        match config.kind {
            DataKind::Humanml3d => files(config),
            DataKind::SyntheticWalks => synthetic_walks(config),
            kind @ (DataKind::Phrases | DataKind::Synthetic) => Err(Error::wrong_kind(
                kind,
                "\"humanml3d\" or \"synthetic_walks\"",
                "phrases are not clips: use a recipe or command for phrases",
            )),
        }
    }
}

/// Synthetic walks, split by the rule of the config.
fn synthetic_walks(config: &DataConfig) -> Result<Scan<Clip>, Error> {
    let conditional = config.humanml3d.reads_embeddings();
    let split = Split::new(&config.validation)?;
    let mut listed = Listed::synthetic(config.synthetic.phrases, synthetic_id);
    listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
    Ok(Scan {
        representation: config.humanml3d.representation(),
        stored_statistics: None,
        warnings: split.idle_entries(ids(&listed)),
        split: Some(split),
        source: Box::new(Walks::new(config, conditional)),
        listed,
    })
}

/// Clips in files, split by the dataset's lists.
fn files(config: &DataConfig) -> Result<Scan<Clip>, Error> {
    let humanml3d = &config.humanml3d;
    let mut warnings = Vec::new();
    let source = config.source.as_deref().unwrap_or_default();
    let store = Store::open(source, &config.store)?;
    let files = Files::open(store, config, &mut warnings)?;
    let mut listed = read_lists(&files, humanml3d, &mut warnings)?;
    listed.truncate(config.num_phrases.unwrap_or(usize::MAX));
    let representation = humanml3d.representation();
    let statistics = statistics::read_stored(&files, &representation)?;
    let embeddings = match humanml3d.reads_embeddings() {
        true => read_embeddings(&files, &humanml3d.text_embeddings, &mut warnings)?,
        false => None,
    };
    let (stored_statistics, fingerprint) = match statistics {
        Some((statistics, [mean, std])) => (Some(statistics), format!("{mean}{std}")),
        None => (None, String::new()),
    };
    Ok(Scan {
        split: None,
        warnings,
        listed,
        source: Box::new(ClipFiles {
            files,
            skeleton: representation.skeleton.clone(),
            captions_required: match humanml3d.captions {
                Some(rule) => rule == CaptionRule::Required,
                None => embeddings.is_some() || humanml3d.text == CaptionText::Labels,
            },
            embeddings,
            min_frames: humanml3d.min_frames,
            max_frames: humanml3d.max_frames,
            fingerprint,
        }),
        stored_statistics,
        representation,
    })
}

fn read_embeddings(
    files: &Files,
    path: &str,
    warnings: &mut Vec<String>,
) -> Result<Option<Embeddings>, Error> {
    let name = files.store.name_of(path);
    match files.find(path, MAX_TENSOR_BYTES)? {
        Some((bytes, digest)) => Ok(Some(Embeddings::parse(&bytes, &name, digest)?)),
        None => {
            warnings.push(format!(
                "{name}: not found; clips have no condition (docs/dataset.md shows how to make \
                 the file; data.humanml3d.text_embeddings = \"\" does without)"
            ));
            Ok(None)
        }
    }
}

#[cfg(test)]
#[path = "scan_tests.rs"]
mod tests;
