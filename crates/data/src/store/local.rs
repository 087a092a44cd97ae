//! A dataset in a local folder.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{Backend, Object, StoreError};
use crate::file::read_file;
use crate::layout::check_path;
use crate::{Error, atomic};

/// A folder; reads never leave it.
#[derive(Clone, Debug)]
pub(super) struct Folder {
    root: PathBuf,
}

impl Folder {
    pub fn new(root: PathBuf) -> Self {
        Self { root }
    }

    /// Path of a file in the folder; the file need not exist.
    fn checked(&self, path: &str) -> Result<PathBuf, StoreError> {
        check_path(path)?;
        // Existing folders may be links; new folders are created in the last existing folder.
        let mut folder = Path::new(path);
        while let Some(parent) = folder.parent().filter(|parent| *parent != Path::new("")) {
            folder = parent;
            if fs::symlink_metadata(self.root.join(folder)).is_ok() {
                self.inside(&folder.to_string_lossy())?;
                break;
            }
        }
        Ok(self.root.join(path))
    }

    /// The full path, if it stays in the folder after following links.
    fn inside(&self, path: &str) -> Result<PathBuf, StoreError> {
        check_path(path)?;
        let full = self.root.join(path);
        let real = full.canonicalize().map_err(|reason| {
            // A checkout without its large files has such links.
            let dangling = fs::symlink_metadata(&full).is_ok_and(|data| data.is_symlink());
            match dangling {
                true => broken(&full, "read", "a symbolic link to nothing"),
                false => failed(&full, "read", &reason),
            }
        })?;
        let root = self.root.canonicalize();
        let root = root.map_err(|reason| failed(&full, "read", &reason))?;
        if !real.starts_with(&root) {
            return Err(StoreError::Outside {
                object: full.display().to_string(),
                target: real.display().to_string(),
            });
        }
        Ok(full)
    }
}

impl Backend for Folder {
    fn uri(&self) -> String {
        self.root.display().to_string()
    }

    fn is_remote(&self) -> bool {
        false
    }

    fn read(&self, path: &str, limit: u64) -> Result<(Vec<u8>, String), StoreError> {
        let full = self.inside(path)?;
        let bytes = read_file(&full, limit).map_err(|reason| match reason.kind() {
            ErrorKind::FileTooLarge => StoreError::TooLarge {
                object: full.display().to_string(),
                found: fs::metadata(&full).map_or(0, |found| found.len()),
                limit,
            },
            _ => failed(&full, "read", &reason),
        })?;
        Ok((bytes, String::new()))
    }

    fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), StoreError> {
        let full = self.checked(path)?;
        atomic::write(&full, &bytes).map_err(|error| match error {
            Error::Io { reason, .. } => failed(&full, "write", &reason),
            other => broken(&full, "write", other),
        })
    }

    /// Removes a file, if it exists, and the file's empty folder below the root.
    fn remove(&self, path: &str) -> Result<(), StoreError> {
        let full = match self.inside(path) {
            Ok(full) => full,
            Err(StoreError::Missing(_)) => return Ok(()),
            Err(error) => return Err(error),
        };
        fs::remove_file(&full).map_err(|reason| failed(&full, "remove", &reason))?;
        if let Some(folder) = full.parent().filter(|folder| *folder != self.root) {
            // Removing fails if the folder is not empty.
            let _ = fs::remove_dir(folder);
        }
        Ok(())
    }

    fn place(&self, path: &str) -> Result<Option<PathBuf>, StoreError> {
        self.checked(path).map(Some)
    }

    /// Hidden files and folders are left out. A folder is listed without its file, because reading
    /// reports the missing file.
    fn list(&self, folder: &str, file: Option<&str>) -> Result<Vec<Object>, StoreError> {
        let place = self.root.join(folder);
        let unreadable = |reason| failed(&place, "list", &reason);
        let mut objects = Vec::new();
        for entry in fs::read_dir(&place).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let found = match file {
                Some(_) => entry.path().is_dir(),
                None => entry.path().is_file(),
            };
            if name.starts_with('.') || !found {
                continue;
            }
            let path = match file {
                Some(file) => format!("{folder}/{name}/{file}"),
                None => format!("{folder}/{name}"),
            };
            objects.push(Object {
                bytes: fs::metadata(self.root.join(&path)).map_or(0, |metadata| metadata.len()),
                version: String::new(),
                path,
            });
        }
        Ok(objects)
    }
}

fn failed(path: &Path, action: &'static str, reason: &std::io::Error) -> StoreError {
    let object = path.display().to_string();
    match reason.kind() {
        ErrorKind::NotFound => StoreError::Missing(object),
        ErrorKind::PermissionDenied => StoreError::Denied {
            object,
            reason: reason.to_string(),
        },
        _ => broken(path, action, reason),
    }
}

fn broken(path: &Path, action: &'static str, reason: impl ToString) -> StoreError {
    StoreError::Failed {
        object: path.display().to_string(),
        action,
        attempts: 1,
        reason: reason.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_listed() {
        let folder = tempfile::tempdir().unwrap();
        let store = Folder::new(folder.path().to_owned());
        store
            .write("motion/a/trajectory.npy", b"abc".to_vec())
            .unwrap();
        fs::create_dir_all(folder.path().join("motion/.hidden")).unwrap();
        fs::create_dir_all(folder.path().join("motion/empty")).unwrap();
        fs::write(folder.path().join("motion/loose"), b"").unwrap();
        assert_eq!(store.read("motion/a/trajectory.npy", 3).unwrap().0, b"abc");
        let mut listed = store.list("motion", Some("trajectory.npy")).unwrap();
        listed.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        let listed: Vec<_> = listed.iter().map(|o| (o.path.as_str(), o.bytes)).collect();
        assert_eq!(
            listed,
            [
                ("motion/a/trajectory.npy", 3),
                ("motion/empty/trajectory.npy", 0)
            ]
        );
        assert!(matches!(
            store.read("motion/a/trajectory.npy", 2),
            Err(StoreError::TooLarge { .. })
        ));
        assert!(matches!(
            store.read("motion/b/trajectory.npy", 9),
            Err(StoreError::Missing(_))
        ));
    }

    #[cfg(unix)]
    #[test]
    fn links_may_stay_inside_and_not_lead_out() {
        use std::os::unix::fs::symlink;
        let outside = tempfile::tempdir().unwrap();
        fs::write(outside.path().join("secret"), b"secret").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let store = Folder::new(folder.path().to_owned());
        store.write("motion/a/x", b"inside".to_vec()).unwrap();
        symlink(
            folder.path().join("motion/a"),
            folder.path().join("motion/b"),
        )
        .unwrap();
        symlink(
            outside.path().join("secret"),
            folder.path().join("motion/a/y"),
        )
        .unwrap();
        symlink(outside.path(), folder.path().join("motion/c")).unwrap();
        assert_eq!(store.read("motion/b/x", 99).unwrap().0, b"inside");
        for path in ["motion/a/y", "motion/c/secret"] {
            let error = store.read(path, 99).unwrap_err();
            assert!(
                matches!(error, StoreError::Outside { .. }),
                "{path}: {error}"
            );
        }
        for path in [
            "../secret",
            "/etc/passwd",
            "motion/../../x",
            "motion//x",
            "a\\b",
        ] {
            let error = store.read(path, 99).unwrap_err();
            assert!(matches!(error, StoreError::Path { .. }), "{path}: {error}");
            assert!(store.write(path, Vec::new()).is_err(), "{path}");
        }
        for path in ["motion/c/new", "motion/c/deep/new"] {
            let error = store.write(path, Vec::new()).unwrap_err();
            assert!(
                matches!(error, StoreError::Outside { .. }),
                "{path}: {error}"
            );
        }
        assert_eq!(fs::read_dir(outside.path()).unwrap().count(), 1);
        assert!(store.remove("motion/c/secret").is_err());
        store.remove("motion/b/x").unwrap();
        store.remove("motion/b/x").unwrap();
        assert!(!folder.path().join("motion/a/x").exists());
    }
}
