//! `manifest.parquet`: one row for each phrase, with where it comes from and its checksums.
//!
//! Reading and writing it needs the Cargo feature `manifest`; without it every attempt is
//! [`Error::Feature`](crate::Error::Feature).

#[cfg(not(feature = "manifest"))]
mod absent;
#[cfg(feature = "manifest")]
mod filter;
#[cfg(feature = "manifest")]
mod footer;
#[cfg(feature = "manifest")]
mod pages;
#[cfg(feature = "manifest")]
mod parquet;
mod row;
#[cfg(feature = "manifest")]
mod table;

#[cfg(not(feature = "manifest"))]
pub use absent::{Manifest, Selection};
#[cfg(feature = "manifest")]
pub use parquet::{Manifest, Selection};
pub use row::{Flag, ManifestRow};

/// The longest manifest that is read: some millions of phrases.
pub const MAX_BYTES: u64 = 1 << 30;

/// Whether this build reads and writes manifests.
pub const SUPPORTED: bool = cfg!(feature = "manifest");
