//! Atomic file writes.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Error;

/// Number of writes started by this process.
static WRITERS: AtomicU64 = AtomicU64::new(0);

/// Writes `bytes` to `path` atomically: to a temporary file beside `path`, which is flushed and
/// renamed. Missing parent folders are created. Fails with [`Error::Io`]; a failed write leaves an
/// older `path` unchanged.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let failed = |reason| Error::io("write", path, reason);
    if path.file_name().is_none() {
        return Err(failed(io::Error::other("the path names no file")));
    }
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    // If several threads write the same file, one of them wins.
    let writer = WRITERS.fetch_add(1, Ordering::Relaxed);
    let temporary = path.with_added_extension(format!("{}-{writer}.tmp", std::process::id()));
    let written = File::create(&temporary).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    });
    written.map_err(|reason| {
        let _ = fs::remove_file(&temporary);
        failed(reason)
    })
}

/// True if a file is the temporary file of an interrupted [`write()`].
pub fn is_unfinished(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let writer = name
        .strip_suffix(".tmp")
        .and_then(|name| name.rsplit_once('.'));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let parts = writer.and_then(|(_, writer)| writer.split_once('-'));
    parts.is_some_and(|(process, number)| is_number(process) && is_number(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_temporary_files_of_a_write_are_unfinished() {
        for (name, is) in [
            ("a/b.txt.1996-149.tmp", true),
            ("b.txt.tmp", false),
            ("b.txt.1996-149", false),
            ("b.txt.x-1.tmp", false),
            ("1-2.tmp", false),
        ] {
            assert_eq!(is_unfinished(Path::new(name)), is, "{name}");
        }
    }

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
