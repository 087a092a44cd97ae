//! The manifest as a Parquet file.

use std::collections::HashSet;
use std::io::Cursor;

use kinegrad_audio::guard::guarded;
use polars::df;
use polars::prelude::{
    BooleanChunked, Column, DataFrame, DataType, NewChunkedArray, ParquetReader, ParquetWriter,
    PolarsError, SerReader,
};

use super::filter::Filter;
use super::footer;
use super::row::{Flag, ManifestRow};
use crate::layout::{MANIFEST, check_id};
use crate::{Digest, Error, Side, Store, StoreError};

/// The columns that kinegrad writes.
const COLUMNS: [&str; 14] = [
    "id",
    "motion_source",
    "audio_source",
    "first_frame",
    "frames",
    "fps",
    "beats",
    "tempo",
    "split",
    "motion_bytes",
    "motion_sha256",
    "audio_bytes",
    "audio_sha256",
    "flags",
];

/// Every phrase of a dataset, one row each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Manifest {
    rows: Vec<ManifestRow>,
}

/// Rows of a manifest, with all its columns: those of kinegrad and any that others have added.
#[derive(Clone, Debug)]
pub struct Selection {
    frame: DataFrame,
}

impl Manifest {
    /// A manifest of `rows`, sorted by id.
    pub(super) fn new(mut rows: Vec<ManifestRow>) -> Self {
        rows.sort_unstable_by(|a, b| a.id.cmp(&b.id));
        Self { rows }
    }

    /// Its rows.
    pub fn rows(&self) -> &[ManifestRow] {
        &self.rows
    }

    /// Reads the manifest of `store`; `None` if it has none.
    ///
    /// # Errors
    /// [`Error::Store`]; [`Error::Manifest`] for a file that is none, a missing column, an id that
    /// is no plain name or occurs twice, a checksum that is none.
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        let Some(bytes) = bytes_of(store)? else {
            return Ok(None);
        };
        Self::from_bytes(bytes, &store.name_of(MANIFEST)).map(Some)
    }

    /// Reads a Parquet file; `object` names it in errors.
    ///
    /// # Errors
    /// [`Error::Manifest`], as [`read`](Self::read).
    pub fn from_bytes(bytes: Vec<u8>, object: &str) -> Result<Self, Error> {
        let rows = decode(bytes, Some(&COLUMNS)).and_then(|frame| rows(&frame));
        let rows = rows.map_err(|problem| Error::Manifest {
            object: object.to_owned(),
            problem,
        })?;
        Ok(Self { rows })
    }

    /// Writes the manifest of `rows` into `store`; equal rows make equal bytes.
    ///
    /// # Errors
    /// [`Error::Store`].
    pub fn write(store: &Store, rows: Vec<ManifestRow>) -> Result<(), Error> {
        let bytes = Self::new(rows)
            .to_bytes()
            .map_err(|error| Error::Manifest {
                object: store.name_of(MANIFEST),
                problem: error.to_string(),
            })?;
        Ok(store.write(MANIFEST, bytes)?)
    }

    pub(super) fn to_bytes(&self) -> Result<Vec<u8>, PolarsError> {
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes).finish(&mut table(&self.rows)?)?;
        Ok(bytes)
    }
}

impl Selection {
    /// All rows of the manifest of `store`; `None` if it has none.
    ///
    /// # Errors
    /// [`Error::Store`]; [`Error::Manifest`] for a file that is none.
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        let Some(bytes) = bytes_of(store)? else {
            return Ok(None);
        };
        let frame = decode(bytes, None).map_err(|problem| Error::Manifest {
            object: store.name_of(MANIFEST),
            problem,
        })?;
        Ok(Some(Self { frame }))
    }

    /// The rows that meet `condition`, as `tempo > 100 and split = train`.
    ///
    /// # Errors
    /// What is wrong with the condition.
    pub fn filter(&self, condition: &str) -> Result<Self, String> {
        let rows = Filter::parse(condition)?.rows(&self.frame)?;
        let mask = BooleanChunked::from_slice("chosen".into(), &rows);
        let frame = self.frame.filter(&mask).map_err(|e| e.to_string())?;
        Ok(Self { frame })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.frame.height()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values of a column of text; missing ones are empty. `None` if there is no such column.
    pub fn texts(&self, column: &str) -> Option<Vec<String>> {
        let column = self.frame.column(column).ok()?;
        let texts = column.cast(&DataType::String).ok()?;
        let texts = texts.str().ok()?;
        Some(
            texts
                .iter()
                .map(|text| text.unwrap_or_default().to_owned())
                .collect(),
        )
    }

    /// The values of a column of numbers. `None` if there is no such column.
    pub fn numbers(&self, column: &str) -> Option<Vec<Option<f64>>> {
        let column = self.frame.column(column).ok()?;
        let numbers = column.cast(&DataType::Float64).ok()?;
        Some(numbers.f64().ok()?.iter().collect())
    }
}

/// The file of the manifest of `store`.
fn bytes_of(store: &Store) -> Result<Option<Vec<u8>>, Error> {
    match store.read(MANIFEST, super::MAX_BYTES) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(StoreError::Missing { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The `wanted` columns that a Parquet file has, or all of them; in an error, what is wrong with it.
pub(super) fn decode(bytes: Vec<u8>, wanted: Option<&[&str]>) -> Result<DataFrame, String> {
    let most_text = footer::most_unpacked(bytes.len());
    // polars panics on some damaged pages.
    let decoded = guarded(|| {
        let file = footer::rewritten(bytes, wanted)?;
        let reader = ParquetReader::new(Cursor::new(file));
        let frame = reader.finish().map_err(|e| e.to_string())?;
        // polars makes tables of columns without comparing their lengths.
        let height = frame.height();
        if let Some(column) = frame.columns().iter().find(|c| c.len() != height) {
            return Err(format!("column `{}` is cut off", column.name()));
        }
        // Cells share the text of a dictionary, until they are copied into rows.
        let text: usize = frame.columns().iter().map(text_bytes).sum();
        if text > most_text {
            return Err(format!("{text} bytes of text, {most_text} allowed"));
        }
        Ok(frame)
    });
    decoded
        .unwrap_or_else(|| Err("its parts contradict each other".to_owned()))
        .map_err(|reason| format!("not a readable Parquet file: {reason}"))
}

/// The bytes of all cells of a column of text.
fn text_bytes(column: &Column) -> usize {
    match (column.str(), column.binary()) {
        (Ok(texts), _) => texts.iter().flatten().map(str::len).sum(),
        (_, Ok(bytes)) => bytes.iter().flatten().map(<[u8]>::len).sum(),
        _ => 0,
    }
}

fn table(rows: &[ManifestRow]) -> Result<DataFrame, PolarsError> {
    let texts = |value: &dyn Fn(&ManifestRow) -> String| rows.iter().map(value).collect::<Vec<_>>();
    let some_texts =
        |value: &dyn Fn(&ManifestRow) -> Option<String>| rows.iter().map(value).collect::<Vec<_>>();
    let integers = |value: &dyn Fn(&ManifestRow) -> i64| rows.iter().map(value).collect::<Vec<_>>();
    let numbers =
        |value: &dyn Fn(&ManifestRow) -> Option<f64>| rows.iter().map(value).collect::<Vec<_>>();
    df!(
        "id" => texts(&|row| row.id.clone()),
        "motion_source" => texts(&|row| row.motion_source.clone()),
        "audio_source" => some_texts(&|row| row.audio_source.clone()),
        "first_frame" => integers(&|row| row.first_frame),
        "frames" => integers(&|row| row.frames),
        "fps" => numbers(&|row| Some(row.fps)),
        "beats" => numbers(&|row| row.beats),
        "tempo" => numbers(&|row| row.tempo),
        "split" => some_texts(&|row| row.split.map(|side| side.as_str().to_owned())),
        "motion_bytes" => integers(&|row| row.motion_bytes),
        "motion_sha256" => texts(&|row| row.motion_sha256.to_string()),
        "audio_bytes" => integers(&|row| row.audio_bytes),
        "audio_sha256" => texts(&|row| row.audio_sha256.to_string()),
        "flags" => texts(&|row| {
            row.flags.iter().map(|flag| flag.as_str()).collect::<Vec<_>>().join(",")
        }),
    )
}

/// The rows of a table; in an error, what is wrong with it. Only ids and checksums must be there:
/// a manifest written by hand need not know the rest.
fn rows(frame: &DataFrame) -> Result<Vec<ManifestRow>, String> {
    let required = |name: &str| {
        frame
            .column(name)
            .map_err(|_| format!("column `{name}` is missing"))
    };
    let height = frame.height();
    let ids = texts(required("id")?)?;
    let motion_sha256 = texts(required("motion_sha256")?)?;
    let audio_sha256 = texts(required("audio_sha256")?)?;
    let optional_texts = |name: &str| match frame.column(name) {
        Ok(column) => texts(column),
        Err(_) => Ok(vec![None; height]),
    };
    let optional_numbers = |name: &str| match frame.column(name) {
        Ok(column) => numbers(column),
        Err(_) => Ok(vec![None; height]),
    };
    let motion_source = optional_texts("motion_source")?;
    let audio_source = optional_texts("audio_source")?;
    let split = optional_texts("split")?;
    let flags = optional_texts("flags")?;
    let first_frame = optional_numbers("first_frame")?;
    let frames = optional_numbers("frames")?;
    let fps = optional_numbers("fps")?;
    let beats = optional_numbers("beats")?;
    let tempo = optional_numbers("tempo")?;
    let motion_bytes = optional_numbers("motion_bytes")?;
    let audio_bytes = optional_numbers("audio_bytes")?;
    let whole = |number: Option<f64>| number.unwrap_or_default() as i64;
    let mut seen = HashSet::new();
    (0..height)
        .map(|row| {
            let id = ids[row].clone().ok_or(format!("row {row}: no id"))?;
            check_id(&id).map_err(|error| format!("row {row}: {error}"))?;
            if !seen.insert(id.clone()) {
                return Err(format!("row {row}: id `{id}` occurs twice"));
            }
            let digest = |column: &str, text: &Option<String>| {
                let text = text.as_deref().unwrap_or_default();
                Digest::parse(text).ok_or_else(|| {
                    format!("phrase `{id}`: {column} `{text}` found, 64 hexadecimal digits allowed")
                })
            };
            let split = match split[row].as_deref() {
                None | Some("") => None,
                Some("train") => Some(Side::Train),
                Some("validation") => Some(Side::Validation),
                Some(other) => {
                    return Err(format!(
                        "phrase `{id}`: split `{other}` found; train, validation or nothing allowed"
                    ));
                }
            };
            let flags = flags[row].as_deref().unwrap_or_default().split(',');
            let flags = flags.filter_map(|text| Flag::ALL.into_iter().find(|f| f.as_str() == text));
            Ok(ManifestRow {
                motion_source: motion_source[row].clone().unwrap_or_default(),
                audio_source: audio_source[row].clone(),
                first_frame: whole(first_frame[row]),
                frames: whole(frames[row]),
                fps: fps[row].unwrap_or(kinegrad_motion::FPS),
                beats: beats[row],
                tempo: tempo[row],
                split,
                motion_bytes: whole(motion_bytes[row]),
                motion_sha256: digest("motion_sha256", &motion_sha256[row])?,
                audio_bytes: whole(audio_bytes[row]),
                audio_sha256: digest("audio_sha256", &audio_sha256[row])?,
                flags: flags.collect(),
                id,
            })
        })
        .collect()
}

fn texts(column: &Column) -> Result<Vec<Option<String>>, String> {
    let broken = |error: PolarsError| format!("column `{}`: {error}", column.name());
    let texts = column.cast(&DataType::String).map_err(broken)?;
    let texts = texts.str().map_err(broken)?;
    Ok(texts.iter().map(|text| text.map(str::to_owned)).collect())
}

fn numbers(column: &Column) -> Result<Vec<Option<f64>>, String> {
    let broken = |error: PolarsError| format!("column `{}`: {error}", column.name());
    let numbers = column.cast(&DataType::Float64).map_err(broken)?;
    Ok(numbers.f64().map_err(broken)?.iter().collect())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::StoreConfig;
    use proptest::prelude::*;

    pub(in crate::manifest) fn row(id: &str) -> ManifestRow {
        ManifestRow {
            id: id.to_owned(),
            motion_source: "dance.bvh".to_owned(),
            audio_source: Some("song.mp3".to_owned()),
            first_frame: -30,
            frames: 120,
            fps: 30.0,
            beats: Some(8.5),
            tempo: Some(126.3),
            split: Some(Side::Validation),
            motion_bytes: 12_128,
            motion_sha256: Digest::of(b"motion"),
            audio_bytes: 40_000,
            audio_sha256: Digest::of(b"audio"),
            flags: vec![Flag::JoinedUnits, Flag::FilledGaps],
        }
    }

    fn reread(bytes: &[u8]) -> Result<Option<Manifest>, Error> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(MANIFEST), bytes).unwrap();
        let source = folder.path().display().to_string();
        Manifest::read(&Store::open(&source, &StoreConfig::default()).unwrap())
    }

    #[test]
    fn what_is_written_is_read_and_equal_rows_make_equal_bytes() {
        let alone = ManifestRow {
            audio_source: None,
            beats: None,
            tempo: None,
            split: None,
            flags: vec![Flag::NoAudio, Flag::NoBeats],
            ..row("a")
        };
        let manifest = Manifest::new(vec![row("b"), alone]);
        let bytes = manifest.to_bytes().unwrap();
        assert_eq!(reread(&bytes).unwrap().unwrap(), manifest);
        assert_eq!(bytes, manifest.to_bytes().unwrap());
        assert_eq!(manifest.rows()[0].id, "a");
    }

    #[test]
    fn ids_that_lead_elsewhere_and_broken_columns_are_refused() {
        for (id, expected) in [
            ("../a", "no slash"),
            ("", "empty part"),
            ("/etc", "no slash"),
        ] {
            let bytes = Manifest::new(vec![row(id)]).to_bytes().unwrap();
            let message = reread(&bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{id}: {message}");
        }
        let twice = Manifest::new(vec![row("a"), row("a")]).to_bytes().unwrap();
        let message = reread(&twice).unwrap_err().to_string();
        assert!(message.contains("occurs twice"), "{message}");
        let mut bytes = Vec::new();
        let mut frame = df!("id" => ["a"], "motion_sha256" => ["12"]).unwrap();
        ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
        let message = reread(&bytes).unwrap_err().to_string();
        assert!(
            message.contains("column `audio_sha256` is missing"),
            "{message}"
        );
        assert!(reread(b"PAR1").is_err());
    }

    /// Counts are zigzag numbers, whose lowest bit is the sign: a page of -2 values asked for more
    /// memory than there is.
    #[test]
    fn no_flipped_sign_in_the_first_columns_is_fatal() {
        let whole = Manifest::new(vec![row("a"), row("b")]).to_bytes().unwrap();
        let mut refused = 0;
        for place in 0..whole.len() / 4 {
            let mut bytes = whole.clone();
            bytes[place] ^= 1;
            if let Err(error) = Manifest::from_bytes(bytes, "flipped") {
                refused += usize::from(error.to_string().contains("negative size or count"));
            }
        }
        assert!(refused > 0);
    }

    /// 2000 cells share the one text of a dictionary.
    #[test]
    fn shared_texts_are_bounded() {
        let mut frame = df!("id" => vec!["long".repeat(5000); 2000]).unwrap();
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
        assert!(bytes.len() < 30_000);
        let message = Manifest::from_bytes(bytes, "long").unwrap_err().to_string();
        assert!(message.contains("40000000 bytes of text"), "{message}");
    }

    #[test]
    fn a_selection_keeps_columns_that_others_added() {
        let mut frame = table(&[row("a"), row("b")]).unwrap();
        frame
            .with_column(Column::new("dancer".into(), ["kim", "lou"]))
            .unwrap();
        let selection = Selection { frame };
        let chosen = selection.filter("dancer = lou").unwrap();
        assert_eq!(chosen.texts("id").unwrap(), ["b"]);
        assert_eq!(chosen.numbers("tempo").unwrap(), [Some(126.3)]);
        assert!(chosen.texts("nobody").is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn damaged_manifests_are_refused_not_fatal(place in 0usize..3000, byte: u8, keep in 0.0..1.0f64) {
            let mut bytes = Manifest::new(vec![row("a"), row("b")]).to_bytes().unwrap();
            let length = bytes.len();
            bytes[place % length] = byte;
            let _ = Manifest::from_bytes(bytes.clone(), "damaged");
            bytes.truncate((length as f64 * keep) as usize);
            let _ = Manifest::from_bytes(bytes, "damaged");
        }
    }
}
