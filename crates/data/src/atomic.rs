//! Atomic file writes.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Error;

/// Writes begun by this process.
static WRITERS: AtomicU64 = AtomicU64::new(0);

/// Writes `path` by `fill`: into a temporary name beside it, flushed to disk, then renamed, so that
/// a reader never sees half a file. Missing parent folders are made.
///
/// # Errors
/// [`Error::Io`]; the temporary file is removed and an older `path` stays as it was.
pub(crate) fn write(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), Error> {
    let failed = |reason| Error::io("write", path, reason);
    let Some(name) = path.file_name() else {
        return Err(failed(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            "the path names no file",
        )));
    };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    let mut temporary_name = name.to_owned();
    // Threads, too, may write the same file: then one of them wins, whole.
    let writer = WRITERS.fetch_add(1, Ordering::Relaxed);
    temporary_name.push(format!(".{}-{writer}.tmp", std::process::id()));
    let temporary = path.with_file_name(temporary_name);
    let written = (|| {
        let mut writer = BufWriter::new(File::create(&temporary)?);
        fill(&mut writer)?;
        writer.flush()?;
        writer.get_ref().sync_all()?;
        fs::rename(&temporary, path)
    })();
    written.map_err(|reason| {
        let _ = fs::remove_file(&temporary);
        failed(reason)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/file");
        write(&path, |writer| writer.write_all(b"old")).unwrap();
        let failure = write(&path, |writer| {
            writer.write_all(b"new")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failure.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }
}
