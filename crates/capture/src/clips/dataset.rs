//! The files of a dataset of clips.

use std::collections::BTreeSet;

use kinegrad_data::humanml::{
    Caption, ClipLabels, FEATURES, LABELS, TEXTS, features_bytes, features_path, labels_bytes,
    parse_features, statistics_files, texts_path,
};
use kinegrad_data::manifest::{self, Cells};
use kinegrad_data::{Digest, Error as DataError, MANIFEST, Object, Store, StoreError};
use kinegrad_motion::JointFeatures;
use kinegrad_motion::humanml::{Features, Root, Skeleton};
use kinegrad_motion::representation::Measured;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::captions::Labels;
use super::split::Part;
use crate::Error;
use crate::prepare::Row;
use crate::prepare::output::{Output, Parts};

/// Clips whose statistics are measured at a time.
const CHUNK: usize = 256;

/// The files of a dataset of clips.
pub(super) const CLIPS: Parts = Parts {
    list: clip_files,
    id: clip_id,
    index: &["train.txt", "val.txt", "test.txt", MANIFEST, LABELS],
};

fn clip_files(store: &Store) -> Result<Vec<Object>, StoreError> {
    let mut files = store.list_files(FEATURES, "npy")?;
    files.extend(store.list_files(TEXTS, "txt")?);
    Ok(files)
}

fn clip_id(path: &str) -> Option<&str> {
    let (_, name) = path.rsplit_once('/')?;
    name.rsplit_once('.').map(|(id, _)| id)
}

/// A clip of the dataset.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct ClipRow {
    pub id: String,
    pub take: String,
    /// The motion file, as the plan names it.
    pub file: String,
    pub map: String,
    pub labels: Labels,
    pub captions: Vec<String>,
    /// Its first frame within the take.
    pub first_frame: usize,
    pub frames: usize,
    pub fps: f64,
    pub mirrored: bool,
    pub features_bytes: i64,
    pub features_sha256: Digest,
    pub texts_bytes: i64,
    pub texts_sha256: Digest,
}

impl Row for ClipRow {
    fn files(&self) -> [(String, i64, Digest); 2] {
        let (features, texts) = (features_path(&self.id), texts_path(&self.id));
        [
            (features, self.features_bytes, self.features_sha256),
            (texts, self.texts_bytes, self.texts_sha256),
        ]
    }
}

impl ClipRow {
    /// Writes the files of a clip with these features, and notes their lengths and checksums.
    pub fn write(mut self, features: &Features, output: &Output) -> Result<Self, Error> {
        let lines = self.captions.iter().map(|text| {
            let mut caption = Caption {
                text: text.clone(),
                tokens: Vec::new(),
                seconds: None,
                embedding: None,
            };
            // Lower case, without punctuation.
            caption.tokens = caption.words().into_owned();
            caption.line()
        });
        let texts = lines.collect::<String>().into_bytes();
        let features = features_bytes(features);
        (self.features_bytes, self.features_sha256) =
            (features.len() as i64, Digest::of(&features));
        (self.texts_bytes, self.texts_sha256) = (texts.len() as i64, Digest::of(&texts));
        output.write(&features_path(&self.id), features)?;
        output.write(&texts_path(&self.id), texts)?;
        Ok(self)
    }
}

/// Writes the index: statistics, labels, the manifest and the lists of clips. The list of training
/// clips is last, because readers need this list.
pub(super) fn write_index(store: &Store, rows: &[(ClipRow, Part)]) -> Result<(), Error> {
    for root in [Root::Relative, Root::Absolute] {
        for (path, bytes) in statistics(store, rows, root)? {
            store.write(path, bytes)?;
        }
    }
    let labels = rows.iter().map(|(row, _)| (&row.id, &row.labels));
    let labels: ClipLabels = labels.map(|(id, own)| (id.clone(), own.clone())).collect();
    store.write(LABELS, labels_bytes(&labels))?;
    if manifest::SUPPORTED {
        manifest::write_columns(store, columns(rows))?;
    } else {
        store.remove(MANIFEST)?;
    }
    for part in Part::ALL.into_iter().rev() {
        let ids = rows.iter().filter(|(_, of)| *of == part);
        let list: String = ids.map(|(row, _)| format!("{}\n", row.id)).collect();
        // The reader requires a list of validation clips, even an empty one.
        match list.is_empty() && part == Part::Test {
            true => store.remove(part.list())?,
            false => store.write(part.list(), list.into_bytes())?,
        }
    }
    Ok(())
}

/// Files of the mean and standard deviation of the training clips.
fn statistics(
    store: &Store,
    rows: &[(ClipRow, Part)],
    root: Root,
) -> Result<[(&'static str, Vec<u8>); 2], Error> {
    let skeleton = Skeleton::humanml3d();
    let representation = JointFeatures { skeleton, root };
    let train = rows.iter().filter(|(_, part)| *part == Part::Train);
    let train: Vec<&ClipRow> = train.map(|(row, _)| row).collect();
    let mut all: Option<Measured> = None;
    for chunk in train.chunks(CHUNK) {
        let measured = chunk.par_iter().map(|row| {
            let path = features_path(&row.id);
            let bytes = store.read(&path, row.features_bytes.unsigned_abs())?;
            let file = store.name_of(&path);
            let features = parse_features(&bytes, &file, &representation.skeleton);
            let features = features.map_err(DataError::from)?.with_root(root);
            Ok(Measured::of(&representation, features.as_slice()))
        });
        for measured in measured.collect::<Result<Vec<_>, Error>>()? {
            match &mut all {
                Some(all) => all.merge(measured),
                None => all = Some(measured),
            }
        }
    }
    let statistics = all.expect("a training clip").statistics(&representation);
    Ok(statistics_files(root, &statistics))
}

fn columns(rows: &[(ClipRow, Part)]) -> Vec<(String, Cells)> {
    let text = |value: &dyn Fn(&ClipRow) -> Option<String>| {
        Cells::Texts(rows.iter().map(|(row, _)| value(row)).collect())
    };
    let integer = |value: &dyn Fn(&ClipRow) -> i64| {
        Cells::Integers(rows.iter().map(|(row, _)| value(row)).collect())
    };
    let number = |value: &dyn Fn(&ClipRow) -> f64| {
        Cells::Numbers(rows.iter().map(|(row, _)| value(row)).collect())
    };
    let named = |(name, cells): (&str, Cells)| (name.to_owned(), cells);
    let split = rows.iter().map(|(_, part)| Some(part.name().to_owned()));
    let mirrored = rows.iter().map(|(row, _)| row.mirrored);
    let labels: BTreeSet<&String> = rows.iter().flat_map(|(row, _)| row.labels.keys()).collect();
    let before = [
        ("id", text(&|row| Some(row.id.clone()))),
        ("take", text(&|row| Some(row.take.clone()))),
        ("file", text(&|row| Some(row.file.clone()))),
        ("map", text(&|row| Some(row.map.clone()))),
    ];
    let sha256 = text(&|row| Some(row.features_sha256.to_string()));
    let after = [
        ("first_frame", integer(&|row| row.first_frame as i64)),
        ("frames", integer(&|row| row.frames as i64)),
        ("seconds", number(&|row| row.frames as f64 / row.fps)),
        ("fps", number(&|row| row.fps)),
        ("mirrored", Cells::Flags(mirrored.collect())),
        ("split", Cells::Texts(split.collect())),
        ("caption", text(&|row| row.captions.first().cloned())),
        ("captions", integer(&|row| row.captions.len() as i64)),
        ("features_bytes", integer(&|row| row.features_bytes)),
        ("features_sha256", sha256),
    ];
    let label = |name: &String| (name.clone(), text(&|row| row.labels.get(name).cloned()));
    let mut columns: Vec<(String, Cells)> = before.into_iter().map(named).collect();
    columns.extend(labels.into_iter().map(label));
    columns.extend(after.into_iter().map(named));
    columns
}
