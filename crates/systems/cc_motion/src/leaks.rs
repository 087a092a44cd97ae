//! Held-out phrases and songs in the training data of fine-tuning's initial checkpoints.

use std::collections::BTreeSet;

use kinegrad_data::{DataConfig, DataKind, Dataset, PhraseItem, Songs, song_of};
use kinegrad_train::Observer;
use kinegrad_train::checkpoint::State;

use super::start::Starts;

/// Largest number of phrases or songs in a warning.
const NAMED: usize = 5;

/// Warns about held-out phrases and songs of `dataset` in the training data of an initial run.
pub(super) fn warn(
    starts: &Starts,
    dataset: &Dataset<PhraseItem>,
    data: &DataConfig,
    observer: &mut dyn Observer,
) {
    for (key, state) in starts.states() {
        for warning in warnings(key, state, dataset, data) {
            observer.warning(&warning);
        }
    }
}

fn warnings(
    key: &str,
    state: &State,
    dataset: &Dataset<PhraseItem>,
    data: &DataConfig,
) -> Vec<String> {
    // Datasets with equal digests have equal splits.
    let same = state.dataset_sha256.as_deref() == Some(&dataset.digest.to_string());
    if same || dataset.validation.is_empty() {
        return Vec::new();
    }
    let mut before = state.config.data.clone();
    let is_synthetic = |data: &DataConfig| data.kind == DataKind::Synthetic;
    if is_synthetic(&before) != is_synthetic(data)
        || (is_synthetic(data) && before.synthetic.seed != data.synthetic.seed)
    {
        // Synthetic phrases of different seeds share only their ids.
        return Vec::new();
    }
    before.cache.memory_mib = 0;
    let opened = Dataset::<PhraseItem>::open(&before);
    let opened = opened.map(|trained| (trained.train, [&before, data].map(Songs::read)));
    let (trained, songs) = match opened {
        Ok((trained, [Ok(before), Ok(own)])) => (trained, [before, own]),
        Err(error) | Ok((_, [Err(error), _] | [_, Err(error)])) => {
            return vec![format!(
                "cannot check `{key}` for training on phrases that are held out here: its dataset \
                 cannot be opened: {error}"
            )];
        }
    };
    let seen: BTreeSet<&str> = trained.ids().collect();
    let (leaked, rest): (Vec<&str>, Vec<&str>) =
        dataset.validation.ids().partition(|id| seen.contains(id));
    let count = dataset.validation.len();
    let hint = "Without `data.validation` and with its `data.source` this run holds out what that \
                run did";
    let mut warnings = Vec::new();
    if !leaked.is_empty() {
        warnings.push(format!(
            "`{key}` was trained on {} of the {count} phrases that are held out here, so that \
             measures of them are not of new phrases: {}. {hint}",
            leaked.len(),
            named(&leaked)
        ));
    }
    // Other phrases of a song share the music and the dancer. The takes in ids are also compared,
    // because one of the datasets may not state songs.
    let names = |songs: &Songs, id: &str| [songs.song(id), song_of(id, None)];
    let [before, own] = songs;
    let trained: BTreeSet<String> = trained.ids().flat_map(|id| names(&before, id)).collect();
    let known = |id: &&&str| names(&own, id).iter().any(|name| trained.contains(name));
    let songs: BTreeSet<String> = rest.iter().map(|id| own.song(id)).collect();
    let leaked: BTreeSet<String> = rest.iter().filter(known).map(|id| own.song(id)).collect();
    if !leaked.is_empty() {
        let leaked: Vec<&str> = leaked.iter().map(String::as_str).collect();
        warnings.push(format!(
            "`{key}` was trained on other phrases of {} of the {} songs that are held out here, so \
             that measures of them are not of new songs: {}. {hint}",
            leaked.len(),
            songs.len(),
            named(&leaked)
        ));
    }
    warnings
}

/// The first names, and the number of further names.
fn named(names: &[&str]) -> String {
    let first = names[..names.len().min(NAMED)].join(", ");
    match names.len().saturating_sub(NAMED) {
        0 => first,
        more => format!("{first} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::start::is_of_one_source;
    use super::*;

    #[test]
    fn a_folder_is_one_however_it_is_spelled() {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |source: Option<String>| DataConfig {
            source,
            ..DataConfig::default()
        };
        let plain = folder.path().display().to_string();
        let (one, other) = (of(Some(plain.clone())), of(Some(format!("{plain}/./"))));
        assert!(is_of_one_source(&one, &other));
        assert!(!is_of_one_source(&one, &of(Some(format!("{plain}/other")))));
        assert!(!is_of_one_source(&of(None), &of(None)));
    }
}
