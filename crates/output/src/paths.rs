//! Paths in JSON.

use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};

/// Paths as text, with U+FFFD in place of bytes that are not UTF-8: serde has an error for such
/// paths.
pub trait PathText {
    /// Serializes the text.
    ///
    /// # Errors
    /// Those of the serializer.
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error>;
}

impl PathText for Path {
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.to_string_lossy().serialize(serializer)
    }
}

impl PathText for PathBuf {
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.as_path().serialize_text(serializer)
    }
}

impl PathText for &Path {
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (*self).serialize_text(serializer)
    }
}

impl PathText for Option<PathBuf> {
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let text = self.as_ref().map(|path| path.to_string_lossy());
        text.serialize(serializer)
    }
}

impl PathText for Vec<PathBuf> {
    fn serialize_text<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter().map(|path| path.to_string_lossy()))
    }
}

/// For `#[serde(serialize_with = "kinegrad_output::path_text")]` on paths.
///
/// # Errors
/// Those of the serializer.
pub fn path_text<P: PathText, S: Serializer>(path: &P, serializer: S) -> Result<S::Ok, S::Error> {
    path.serialize_text(serializer)
}

#[cfg(all(test, unix))]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    use super::*;

    #[derive(Serialize)]
    struct Paths<'a> {
        #[serde(serialize_with = "path_text")]
        one: PathBuf,
        #[serde(serialize_with = "path_text")]
        borrowed: &'a Path,
        #[serde(serialize_with = "path_text")]
        none: Option<PathBuf>,
        #[serde(serialize_with = "path_text")]
        some: Option<PathBuf>,
        #[serde(serialize_with = "path_text")]
        all: Vec<PathBuf>,
    }

    #[test]
    fn paths_that_are_not_utf8_are_text() {
        let odd = Path::new(OsStr::from_bytes(b"a\xff"));
        let paths = Paths {
            one: "a".into(),
            borrowed: odd,
            none: None,
            some: Some(odd.into()),
            all: vec!["b".into(), odd.into()],
        };
        let text = r#"{"one":"a","borrowed":"a�","none":null,"some":"a�","all":["b","a�"]}"#;
        assert_eq!(serde_json::to_string(&paths).unwrap(), text);
        assert!(serde_json::to_string(odd).is_err());
    }
}
