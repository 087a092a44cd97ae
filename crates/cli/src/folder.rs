//! Folders of output files.

use std::fs;
use std::path::Path;

use kinegrad_train::Error;

/// Creates a folder and its parents. Fails if a folder cannot be created.
pub fn make(folder: &Path) -> Result<(), Error> {
    // A bare file name has an empty parent.
    if folder.as_os_str().is_empty() {
        return Ok(());
    }
    fs::create_dir_all(folder).map_err(|error| {
        Error::usage(
            format!("cannot create the folder {}: {error}", folder.display()),
            "choose a place in a folder that can be written (`--out`)",
        )
    })
}

/// Creates the folder of a file.
pub fn make_for(file: &Path) -> Result<(), Error> {
    file.parent().map_or(Ok(()), make)
}

/// [`make_for`] that also fails if the file cannot be written.
pub fn must_be_writable(file: &Path) -> Result<(), Error> {
    make_for(file)?;
    if file.is_dir() {
        let message = format!("{} is a folder", file.display());
        return Err(Error::usage(message, "name a file"));
    }
    kinegrad_output::must_be_writable(file).map_err(|error| {
        Error::usage(
            format!("cannot write {}: {error}", file.display()),
            "give a file in a folder that can be written, as with `--out`",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_created_and_unusable_paths_are_named() {
        let top = tempfile::tempdir().unwrap();
        let file = top.path().join("a/b/file");
        must_be_writable(&file).unwrap();
        assert!(!file.exists() && top.path().join("a/b").is_dir());
        assert_eq!(fs::read_dir(top.path().join("a/b")).unwrap().count(), 0);
        fs::write(&file, "").unwrap();
        let error = must_be_writable(&file.join("c/d")).unwrap_err().to_string();
        assert!(error.contains("file/c"), "{error}");
        assert_eq!(must_be_writable(&file).ok(), Some(()));
        let error = must_be_writable(&top.path().join("a"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("is a folder"), "{error}");
        make_for(Path::new("alone")).unwrap();
    }
}
