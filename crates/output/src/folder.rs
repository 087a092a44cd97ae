//! Folders that are complete or absent.

use std::fs;
use std::io;
use std::path::Path;

use tempfile::{Builder, TempDir};

use crate::file::{ENDING, PREFIX, RANDOM};

/// A temporary folder under a new and unpredictable name. Removed unless it is
/// [finished](Self::finish).
#[derive(Debug)]
pub struct UnfinishedFolder(TempDir);

impl UnfinishedFolder {
    /// An empty folder in `folder`, which is created if it is missing.
    ///
    /// # Errors
    /// If a folder cannot be created.
    pub fn within(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let mut builder = Builder::new();
        builder.prefix(PREFIX).suffix(ENDING).rand_bytes(RANDOM);
        // The umask limits them.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        Ok(Self(builder.tempdir_in(folder)?))
    }

    /// The temporary folder.
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Moves the folder to `target`, which does not exist yet.
    ///
    /// # Errors
    /// If it cannot be moved.
    pub fn finish(self, target: &Path) -> io::Result<()> {
        fs::rename(self.path(), target)?;
        let _ = self.0.keep();
        Ok(())
    }

    /// Moves the contents into `folder`, where they replace files of the same names.
    ///
    /// # Errors
    /// If an entry cannot be moved; entries moved before stay.
    pub fn move_into(self, folder: &Path) -> io::Result<()> {
        for entry in fs::read_dir(self.path())? {
            let entry = entry?;
            fs::rename(entry.path(), folder.join(entry.file_name()))?;
        }
        self.0.close()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::is_unfinished;

    #[test]
    fn a_folder_is_moved_whole_or_removed() {
        let top = tempfile::tempdir().unwrap();
        let made = |contents: &str| {
            let made = UnfinishedFolder::within(&top.path().join("deep")).unwrap();
            fs::write(made.path().join("file"), contents).unwrap();
            made
        };
        let target = top.path().join("deep/target");
        let unfinished = made("old");
        assert!(is_unfinished(unfinished.path()));
        drop(made("lost"));
        unfinished.finish(&target).unwrap();
        made("new").move_into(&target).unwrap();
        assert_eq!(fs::read(target.join("file")).unwrap(), b"new");
        assert_eq!(fs::read_dir(top.path().join("deep")).unwrap().count(), 1);
    }
}
