//! The manifest as a Parquet file.

use std::io::Cursor;

use kinegrad_audio::guard::guarded;
use polars::prelude::{
    BooleanChunked, Column, DataFrame, NewChunkedArray, ParquetReader, ParquetWriter, PolarsError,
    SerReader,
};

use super::filter::Filter;
use super::footer;
use super::row::ManifestRow;
use super::table::{self, rows};
use crate::layout::MANIFEST;
use crate::{Error, Store};

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
        let Some(bytes) = store.find(MANIFEST, super::MAX_BYTES)? else {
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
        ParquetWriter::new(&mut bytes).finish(&mut table::table(&self.rows)?)?;
        Ok(bytes)
    }
}

impl Selection {
    /// All rows of the manifest of `store`; `None` if it has none.
    ///
    /// # Errors
    /// [`Error::Store`]; [`Error::Manifest`] for a file that is none.
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        let Some(bytes) = store.find(MANIFEST, super::MAX_BYTES)? else {
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
        self.frame.column(column).ok()?;
        let texts = table::texts(&self.frame, column).ok()?.into_iter();
        Some(texts.map(Option::unwrap_or_default).collect())
    }

    /// The values of a column of numbers. `None` if there is no such column.
    pub fn numbers(&self, column: &str) -> Option<Vec<Option<f64>>> {
        self.frame.column(column).ok()?;
        table::numbers(&self.frame, column).ok()
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::manifest::Flag;
    use crate::{Digest, Side, StoreConfig};
    use polars::df;
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
        let mut frame = table::table(&[row("a"), row("b")]).unwrap();
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
