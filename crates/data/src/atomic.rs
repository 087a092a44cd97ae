//! Atomic file writes.

use std::path::Path;

use crate::Error;

/// Writes `bytes` to `path` atomically with [`kinegrad_output::write`]. Missing parent folders are
/// created. Fails with [`Error::Io`]; a failed write leaves an older `path` unchanged.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let folder = path.parent().map_or(Ok(()), std::fs::create_dir_all);
    let written = folder.and_then(|()| kinegrad_output::write(path, bytes));
    written.map_err(|reason| Error::io("write", path, reason))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/file");
        write(&path, b"old").unwrap();
        assert!(write(path.parent().unwrap(), b"new").is_err());
        assert!(write(&folder.path().join(".."), b"new").is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
