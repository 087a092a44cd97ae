//! Manifests in a build without the feature `manifest`: there are none.

use super::ManifestRow;
use crate::{Error, MANIFEST, Store};

/// Every phrase of a dataset, one row each. This build makes none.
#[derive(Clone, Debug)]
pub struct Manifest(());

/// Rows of a manifest. This build makes none.
#[derive(Clone, Debug)]
pub struct Selection(());

fn lacking(what: String) -> Error {
    Error::Feature {
        what,
        feature: "manifest",
    }
}

impl Manifest {
    /// Writes the manifest of `rows` into `store`.
    ///
    /// # Errors
    /// Always [`Error::Feature`].
    pub fn write(store: &Store, _rows: Vec<ManifestRow>) -> Result<(), Error> {
        Err(lacking(store.name_of(MANIFEST)))
    }

    /// Reads the manifest of `store`.
    ///
    /// # Errors
    /// Always [`Error::Feature`].
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        Err(lacking(store.name_of(MANIFEST)))
    }

    /// Reads a Parquet file; `object` names it in errors.
    ///
    /// # Errors
    /// Always [`Error::Feature`].
    pub fn from_bytes(_bytes: Vec<u8>, object: &str) -> Result<Self, Error> {
        Err(lacking(object.to_owned()))
    }

    /// Its rows.
    pub fn rows(&self) -> &[ManifestRow] {
        &[]
    }
}

impl Selection {
    /// Reads the manifest of `store`.
    ///
    /// # Errors
    /// Always [`Error::Feature`].
    pub fn read(store: &Store) -> Result<Option<Self>, Error> {
        Err(lacking(store.name_of(MANIFEST)))
    }

    /// The rows that meet `condition`.
    ///
    /// # Errors
    /// Always: there are no rows.
    pub fn filter(&self, _condition: &str) -> Result<Self, String> {
        Err("this build reads no manifest".to_owned())
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        0
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        true
    }

    /// The values of a column of text.
    pub fn texts(&self, _column: &str) -> Option<Vec<String>> {
        None
    }

    /// The values of a column of numbers.
    pub fn numbers(&self, _column: &str) -> Option<Vec<Option<f64>>> {
        None
    }
}
