//! Errors of stores.

use kinegrad_settings::counted;
use miette::Diagnostic;
use thiserror::Error;

/// A problem of one object. The object is a path or address.
#[derive(Clone, Debug, Error, Diagnostic)]
pub enum StoreError {
    /// The object does not exist.
    #[error("{0}: not found")]
    #[diagnostic(help("check data.source; was the file moved or deleted?"))]
    Missing(String),
    /// Access is denied.
    #[error("{object}: access denied: {reason}")]
    #[diagnostic(help(
        "credentials come from the environment (GOOGLE_APPLICATION_CREDENTIALS for gs://, \
         AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY for s3://; http sources send none); for a \
         public bucket or an emulator data.store.anonymous = true, or GOOGLE_SKIP_SIGNATURE=true or \
         AWS_SKIP_SIGNATURE=true in the environment, sends none"
    ))]
    Denied {
        /// The object.
        object: String,
        /// The store's reason.
        reason: String,
    },
    /// Every attempt failed.
    #[error("{object}: cannot {action} after {}: {reason}", counted(*attempts, "attempt"))]
    #[diagnostic(help(
        "check the path, its permissions and the free space, and for an address the network; \
         data.store.max_retries and data.store.timeout_seconds say how long kinegrad tries"
    ))]
    Failed {
        /// The object.
        object: String,
        /// The attempted action: `read`, `write`, `list`, `remove`, `open`.
        action: &'static str,
        /// Number of attempts.
        attempts: usize,
        /// The last reason.
        reason: String,
    },
    /// The store's response contradicts itself or has no end.
    #[error("{object}: the store's response is unusable: {reason}")]
    #[diagnostic(help("check the address and data.store.endpoint; is this the intended server?"))]
    Unusable {
        /// The object.
        object: String,
        /// What is wrong with the response.
        reason: String,
    },
    /// The bytes differ from the checksum in the manifest or at the start of the run.
    #[error(
        "{object}: its contents are not those {recorded}: sha256 {found} found, {expected} expected"
    )]
    #[diagnostic(help(
        "the object was changed or damaged: restore it, or prepare the dataset again and \
         start a new run"
    ))]
    Changed {
        /// The object.
        object: String,
        /// Origin of the expected checksum.
        recorded: &'static str,
        /// The found checksum, hexadecimal.
        found: String,
        /// The checksum expected.
        expected: String,
    },
    /// The object is too large.
    #[error("{object}: {found} bytes found, {limit} allowed")]
    #[diagnostic(help("this is not a file of a phrase dataset"))]
    TooLarge {
        /// The object.
        object: String,
        /// Its size in bytes.
        found: u64,
        /// The largest allowed size, bytes.
        limit: u64,
    },
    /// A symbolic link leads out of the dataset's folder.
    #[error("{object}: a symbolic link leads out of the dataset, to {target}")]
    #[diagnostic(help("copy the file into the dataset; links may only stay within it"))]
    Outside {
        /// The object.
        object: String,
        /// Target of the link.
        target: String,
    },
    /// The path is invalid or leads out of the dataset.
    #[error("path `{path}`: {reason}")]
    #[diagnostic(help("ids are plain names: no `/`, no `\\`, no `..`, at most 200 bytes"))]
    Path {
        /// The path.
        path: String,
        /// The problem.
        reason: &'static str,
    },
    /// A web server cannot list objects.
    #[error("{0}: http cannot list phrases and there is no manifest.parquet")]
    #[diagnostic(help(
        "`kinegrad data prepare` writes a manifest; without one a dataset works from a folder, \
         gs:// or s3://"
    ))]
    NoListing(String),
    /// A web server takes no files.
    #[error("{0}: http sources can only be read")]
    #[diagnostic(help("write to a folder, gs:// or s3://"))]
    ReadOnly(String),
}

impl StoreError {
    /// True if the error concerns a single object, not the store or the identity of the dataset.
    pub fn concerns_one_object(&self) -> bool {
        matches!(
            self,
            Self::Missing(_)
                | Self::TooLarge { .. }
                | Self::Unusable { .. }
                | Self::Outside { .. }
                | Self::Path { .. }
        )
    }
}
