//! Labels of the clips of a dataset: `labels.json`.

use std::collections::BTreeMap;

use crate::{DataConfig, DataKind, Error, FileError, Store};

/// The file of labels; only prepared datasets have labels.
pub const LABELS: &str = "labels.json";

/// Largest file of labels.
const MAX_BYTES: u64 = 1 << 28;

/// The labels of each clip by clip id and label name: `content` is `walk`, `style` is `happy`.
pub type ClipLabels = BTreeMap<String, BTreeMap<String, String>>;

/// The bytes of the file of `labels`.
pub fn labels_bytes(labels: &ClipLabels) -> Vec<u8> {
    serde_json::to_vec_pretty(labels).expect("plain data")
}

/// Reads the labels of the dataset in `store`; `None` without labels. Fails with [`Error::Store`];
/// [`Error::File`] for an invalid file.
pub fn read_labels(store: &Store) -> Result<Option<ClipLabels>, Error> {
    let Some(bytes) = store.find(LABELS, MAX_BYTES)? else {
        return Ok(None);
    };
    let labels = serde_json::from_slice(&bytes).map_err(|problem| {
        FileError::unexpected(
            store.name_of(LABELS),
            problem.to_string(),
            "an object with an object of texts for each clip",
            "as in {\"walk_001_00000\": {\"content\": \"walk\", \"style\": \"happy\"}}",
        )
    })?;
    Ok(Some(labels))
}

/// Reads the labels of the dataset of `config`; `None` without labels. Fails as [`read_labels`],
/// and if the dataset's location cannot be opened.
pub fn labels_of(config: &DataConfig) -> Result<Option<ClipLabels>, Error> {
    match (config.kind, &config.source) {
        (DataKind::Humanml3d, Some(source)) => read_labels(&Store::open(source, &config.store)?),
        _ => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StoreConfig;

    #[test]
    fn labels_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().display().to_string();
        let store = Store::open(&source, &StoreConfig::default()).unwrap();
        assert_eq!(read_labels(&store).unwrap(), None);
        let named = |(a, b): (&str, &str)| (a.to_owned(), b.to_owned());
        let walk = [("content", "walk"), ("style", "happy")].map(named);
        let labels = ClipLabels::from([
            ("a_00000".to_owned(), walk.into_iter().collect()),
            ("b_00000".to_owned(), BTreeMap::new()),
        ]);
        store.write(LABELS, labels_bytes(&labels)).unwrap();
        assert_eq!(read_labels(&store).unwrap(), Some(labels));
        store.write(LABELS, b"{\"a\": 3}".to_vec()).unwrap();
        let message = read_labels(&store).unwrap_err().to_string();
        assert!(message.contains("labels.json"), "{message}");
    }
}
