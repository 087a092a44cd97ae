//! Where the reference files are.

use std::path::{Path, PathBuf};

use crate::workspace;

/// A folder of reference files, each named by its path below, as `ccmotion/03_unet.safetensors`.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
    complete: bool,
}

impl Folder {
    /// The folder that `KINEGRAD_GOLDEN` names, which must hold every file; where it is not set,
    /// `data_fixtures/golden`, which need not.
    pub fn in_use() -> Self {
        match std::env::var_os("KINEGRAD_GOLDEN").filter(|folder| !folder.is_empty()) {
            // Tests run in their package's folder; a relative folder is meant from the root.
            Some(folder) => Self::new(workspace().join(folder), true),
            None => Self::new(workspace().join("data_fixtures/golden"), false),
        }
    }

    /// The folder `root`; whether a file that it lacks is an error.
    pub fn new(root: impl Into<PathBuf>, complete: bool) -> Self {
        let root = root.into();
        Self { root, complete }
    }

    /// Whether a file that is not there is an error.
    pub fn must_be_complete(&self) -> bool {
        self.complete
    }

    /// Its place on disk.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The path of a file, there or not.
    pub fn path(&self, file: &str) -> PathBuf {
        self.root.join(file)
    }
}
