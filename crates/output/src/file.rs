//! Files.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

/// Prefix of temporary files and folders.
pub(crate) const PREFIX: &str = ".writing-";

/// Ending of temporary files and folders.
pub(crate) const ENDING: &str = ".tmp";

/// Length of the random part of a temporary name.
pub(crate) const RANDOM: usize = 10;

/// True for the name of a temporary file or folder, which an interrupted process leaves.
pub fn is_unfinished(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(PREFIX) && name.ends_with(ENDING)
}

/// Removes the temporary files that interrupted processes left in `folder` and in the folders within
/// it, but not behind links.
pub fn remove_unfinished(folder: &Path) {
    let entries = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect()
    };
    let inside = entries(folder).into_iter();
    let (folders, files): (Vec<_>, Vec<_>) =
        inside.partition(|path| path.is_dir() && !path.is_symlink());
    let files = files.into_iter();
    for file in files.chain(folders.iter().flat_map(|folder| entries(folder))) {
        if is_unfinished(&file) {
            // Another process may have removed it.
            let _ = fs::remove_file(file);
        }
    }
}

/// A temporary file beside its target, under a new and unpredictable name. Removed unless it is
/// [finished](Self::finish).
#[derive(Debug)]
pub struct Unfinished {
    temporary: TempPath,
    target: PathBuf,
    permissions: Permissions,
}

impl Unfinished {
    /// An empty file beside `target`, whose folder exists.
    ///
    /// # Errors
    /// If `target` is a folder, a pipe or a device, or the file cannot be created.
    pub fn new(target: &Path) -> io::Result<Self> {
        Self::with(target, &[])
    }

    /// A file of these bytes beside `target`.
    ///
    /// # Errors
    /// As [`new`](Self::new), and if the bytes cannot be written.
    pub fn with(target: &Path, bytes: &[u8]) -> io::Result<Self> {
        if target.file_name().is_none() {
            return Err(io::Error::other("the path names no file"));
        }
        match fs::metadata(target) {
            Ok(found) if found.is_dir() => return Err(ErrorKind::IsADirectory.into()),
            Ok(found) if !found.is_file() => return Err(no_file()),
            _ => {}
        }
        let mut builder = Builder::new();
        builder.prefix(PREFIX).suffix(ENDING).rand_bytes(RANDOM);
        // Unlike the crate's own files, the file is readable as the umask permits.
        let create = |path: &Path| OpenOptions::new().write(true).create_new(true).open(path);
        let (mut file, temporary) = builder.make_in(folder_of(target), create)?.into_parts();
        file.write_all(bytes)?;
        Ok(Self {
            temporary,
            target: target.to_path_buf(),
            permissions: file.metadata()?.permissions(),
        })
    }

    /// The temporary file, for libraries and programs that write to a path.
    pub fn path(&self) -> &Path {
        &self.temporary
    }

    /// Flushes the file and moves it to its target. A link at the target is replaced, not followed.
    ///
    /// # Errors
    /// If the file cannot be flushed or moved; the target is unchanged then.
    pub fn finish(self) -> io::Result<()> {
        self.flush()?;
        Ok(self.temporary.persist(&self.target)?)
    }

    /// [`finish`](Self::finish) for a target that does not exist yet.
    ///
    /// # Errors
    /// As [`finish`](Self::finish), and [`ErrorKind::AlreadyExists`].
    pub fn finish_new(self) -> io::Result<()> {
        self.flush()?;
        Ok(self.temporary.persist_noclobber(&self.target)?)
    }

    fn flush(&self) -> io::Result<()> {
        let file = OpenOptions::new().append(true).open(&self.temporary)?;
        // A library may have replaced the file by one that only its owner can read.
        file.set_permissions(self.permissions.clone())?;
        file.sync_all()
    }
}

/// Writes a file atomically: to a temporary file, which is flushed and renamed. If several processes
/// write the same file, one of them wins.
///
/// # Errors
/// If the file cannot be written; an older file is unchanged then.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    Unfinished::with(path, bytes)?.finish()
}

/// [`write()`] for a path that does not exist yet.
///
/// # Errors
/// As [`write()`], and [`ErrorKind::AlreadyExists`].
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    Unfinished::with(path, bytes)?.finish_new()
}

/// Checks that a file can be written.
///
/// # Errors
/// The error of [`write()`].
pub fn must_be_writable(path: &Path) -> io::Result<()> {
    Unfinished::new(path).map(drop)
}

/// Opens or creates a file to append to it.
///
/// # Errors
/// If the path is a link, a folder, a pipe or a device, or cannot be opened.
pub fn append(path: &Path) -> io::Result<File> {
    open_plain(path, OpenOptions::new().append(true))
}

/// Opens or creates a file for locking.
///
/// # Errors
/// As [`append`].
pub fn lock(path: &Path) -> io::Result<File> {
    open_plain(path, OpenOptions::new().write(true).truncate(false))
}

fn open_plain(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
        Ok(found) if found.is_symlink() => return Err(link()),
        Ok(found) if found.is_dir() => return Err(ErrorKind::IsADirectory.into()),
        Ok(found) if !found.is_file() => return Err(no_file()),
        Ok(_) => {}
    }
    // The path may become a link meanwhile.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(options, libc::O_NOFOLLOW);
    options.create(true).open(path)
}

fn link() -> io::Error {
    let message = "it is a symbolic link: files are not written through links";
    io::Error::new(ErrorKind::InvalidInput, message)
}

fn no_file() -> io::Error {
    let message = "it is a pipe or a device, not a file";
    io::Error::new(ErrorKind::InvalidInput, message)
}

/// The folder of a file; `.` for a bare name.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_or_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write(&path, b"old").unwrap();
        must_be_writable(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        drop(Unfinished::with(&path, b"half").unwrap());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        let error = write_new(&path, b"new").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        for bad in [
            folder.path(),
            Path::new("/"),
            Path::new(".."),
            &path.join("below"),
        ] {
            write(bad, b"new").unwrap_err();
            must_be_writable(bad).unwrap_err();
        }
        write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[test]
    fn many_writers_of_one_file_do_not_meet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..50).for_each(|_| write(&path, &[b'x'; 4096]).unwrap()));
            }
        });
        assert_eq!(fs::read(&path).unwrap(), [b'x'; 4096]);
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[test]
    fn temporary_names_are_known_and_not_predictable() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("x".repeat(255));
        let (one, other) = (
            Unfinished::new(&target).unwrap(),
            Unfinished::new(&target).unwrap(),
        );
        assert_ne!(one.path(), other.path());
        assert!(is_unfinished(one.path()));
        for name in ["file", "a.tmp", ".writing-samples", "b.txt.1996-149.tmp"] {
            assert!(!is_unfinished(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn what_interrupted_processes_left_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("inner");
        fs::create_dir(&inner).unwrap();
        for path in [folder.path(), &inner] {
            fs::write(path.join(".writing-0123456789.tmp"), "half").unwrap();
            fs::write(path.join("file"), "whole").unwrap();
        }
        remove_unfinished(folder.path());
        assert_eq!(names(&inner), ["file"]);
        assert_eq!(names(folder.path()), ["file", "inner"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_replaced_or_refused_and_never_written_through() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [precious, linked] = ["precious", "linked"].map(|name| folder.path().join(name));
        fs::write(&precious, "mine").unwrap();
        symlink(&precious, &linked).unwrap();
        for error in [append(&linked).unwrap_err(), lock(&linked).unwrap_err()] {
            assert!(error.to_string().contains("symbolic link"), "{error}");
        }
        write(&linked, b"new").unwrap();
        assert!(!linked.is_symlink());
        assert_eq!(fs::read(&precious).unwrap(), b"mine");
        append(&precious).unwrap().write_all(b" and more").unwrap();
        assert_eq!(fs::read(&precious).unwrap(), b"mine and more");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&linked), mode(&precious), "the umask's permissions");
        for device in ["/dev/null", "/dev/zero"] {
            for error in [
                write(Path::new(device), b"").unwrap_err(),
                append(Path::new(device)).unwrap_err(),
            ] {
                assert!(error.to_string().contains("a device"), "{error}");
            }
        }
    }
}
