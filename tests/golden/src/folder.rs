//! The folder of reference files.

use std::path::{Path, PathBuf};

use crate::workspace;

/// A folder of reference files, each named by its relative path, such as
/// `ccmotion/03_unet.safetensors`.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
    complete: bool,
}

impl Folder {
    /// The folder that `KINEGRAD_GOLDEN` names, which must contain every file; if it is not set,
    /// `data_fixtures/golden`, which may lack some.
    pub fn in_use() -> Self {
        match std::env::var_os("KINEGRAD_GOLDEN").filter(|folder| !folder.is_empty()) {
            // Tests run in their package's folder; a relative path starts at the repository's root.
            Some(folder) => Self::new(workspace().join(folder), true),
            None => Self::new(workspace().join("data_fixtures/golden"), false),
        }
    }

    /// The folder `root`. If it is `complete`, a missing file is an error.
    pub fn new(root: impl Into<PathBuf>, complete: bool) -> Self {
        let root = root.into();
        Self { root, complete }
    }

    /// True if a missing file is an error.
    pub fn must_be_complete(&self) -> bool {
        self.complete
    }

    /// The path on disk.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The path of a file, existing or not.
    pub fn path(&self, file: &str) -> PathBuf {
        self.root.join(file)
    }
}
