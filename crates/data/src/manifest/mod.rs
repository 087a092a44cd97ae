//! `manifest.parquet`: one row for each phrase, with sources and checksums. Without the Cargo
//! feature `manifest`, reading or writing a manifest fails with [`Error::Feature`].

#[cfg(feature = "manifest")]
mod filter;
#[cfg(feature = "manifest")]
mod footer;
#[cfg(feature = "manifest")]
mod pages;
mod row;
mod songs;
#[cfg_attr(not(feature = "manifest"), path = "absent.rs")]
mod table;
#[cfg(all(test, feature = "manifest"))]
mod tests;

pub use row::{Flag, ManifestRow};
pub use songs::Songs;

use crate::layout::MANIFEST;
use crate::{Error, Store};
use table::DataFrame;

/// Largest manifest.
pub const MAX_BYTES: u64 = 1 << 30;

/// True if this build reads and writes manifests.
pub const SUPPORTED: bool = cfg!(feature = "manifest");

/// Reads the manifest of `store`; `None` without a manifest. Fails with [`Error::Store`];
/// [`Error::Manifest`] for another kind of file, a missing column, an invalid or repeated id, or an
/// invalid checksum.
pub fn read(store: &Store) -> Result<Option<Vec<ManifestRow>>, Error> {
    let bytes = store.find(MANIFEST, MAX_BYTES)?;
    let rows = bytes.map(|bytes| parse(bytes, &store.name_of(MANIFEST)));
    rows.transpose()
}

/// Reads a Parquet file; `object` names the file in errors. Fails with [`Error::Manifest`], as
/// [`read`].
pub fn parse(bytes: Vec<u8>, object: &str) -> Result<Vec<ManifestRow>, Error> {
    attempt(object, || table::rows(bytes))
}

/// Writes the manifest of `rows`, sorted by id, into `store`. Equal rows give equal bytes. Fails
/// with [`Error::Store`].
pub fn write(store: &Store, rows: Vec<ManifestRow>) -> Result<(), Error> {
    let bytes = attempt(&store.name_of(MANIFEST), || table::encode(rows))?;
    Ok(store.write(MANIFEST, bytes)?)
}

/// The cells of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Text; `None` if unknown.
    Texts(Vec<Option<String>>),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Numbers.
    Numbers(Vec<f64>),
    /// Booleans.
    Flags(Vec<bool>),
}

/// Writes a manifest of named columns of equal length into `store`, for datasets without phrases.
/// Fails with [`Error::Store`]; [`Error::Manifest`] for columns of different lengths or with the
/// same name.
pub fn write_columns(store: &Store, columns: Vec<(String, Cells)>) -> Result<(), Error> {
    let bytes = attempt(&store.name_of(MANIFEST), || table::encode_columns(columns))?;
    Ok(store.write(MANIFEST, bytes)?)
}

/// Runs `made` on the manifest `object`, if this build supports it.
fn attempt<T>(object: &str, made: impl FnOnce() -> Result<T, String>) -> Result<T, Error> {
    let object = object.to_owned();
    if !SUPPORTED {
        return Err(Error::Feature {
            what: object,
            feature: "manifest",
        });
    }
    made().map_err(|problem| Error::Manifest { object, problem })
}

/// Rows of a manifest with all columns, including user-defined ones.
#[derive(Clone, Debug)]
pub struct Selection {
    frame: DataFrame,
}

impl Selection {
    /// Reads all rows of the manifest of `store`; `None` without a manifest. Fails with
    /// [`Error::Store`]; [`Error::Manifest`].
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        let Some(bytes) = store.find(MANIFEST, MAX_BYTES)? else {
            return Ok(None);
        };
        let frame = attempt(&store.name_of(MANIFEST), || table::decode(bytes, None))?;
        Ok(Some(Self { frame }))
    }

    /// The rows that match `condition`, such as `tempo > 100 and split = train`. Fails with the
    /// error of the condition.
    pub fn filter(&self, condition: &str) -> Result<Self, String> {
        let frame = table::filter(&self.frame, condition)?;
        Ok(Self { frame })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.frame.height()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values of a text column; missing ones are empty. `None` without the column.
    pub fn texts(&self, column: &str) -> Option<Vec<String>> {
        let texts = table::texts(self.frame.column(column).ok()?).ok()?;
        Some(texts.into_iter().map(Option::unwrap_or_default).collect())
    }

    /// The values of a numeric column. `None` without the column.
    pub fn numbers(&self, column: &str) -> Option<Vec<Option<f64>>> {
        table::numbers(self.frame.column(column).ok()?).ok()
    }
}
