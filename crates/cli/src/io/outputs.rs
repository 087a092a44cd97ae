//! Output files: their names, a check for existing files, and writing all or none.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

use kinegrad_data::{write_values, write_whole};
use kinegrad_motion::humanml::Features;
use kinegrad_train::Error;

/// The prefix of output file names from `--out`, without `.npy`. Fails if `--out` names a folder.
pub fn stem(out: &Path) -> Result<OsString, Error> {
    // The text decides only; names need not be UTF-8.
    let text = out.to_string_lossy();
    let stem = text.strip_suffix(".npy").unwrap_or(&text);
    let name = stem.rsplit(['/', MAIN_SEPARATOR]).next();
    if !matches!(name, None | Some("" | "." | "..")) {
        return Ok(match text.ends_with(".npy") {
            true => out.with_extension("").into_os_string(),
            false => out.as_os_str().to_owned(),
        });
    }
    let folder = Path::new(if stem.is_empty() { "./" } else { stem });
    Err(Error::usage(
        format!("`--out {text}` names no file: it is the beginning of a path, such as dances/one"),
        format!(
            "for files in that folder: `--out {}`",
            folder.join("sample").display()
        ),
    ))
}

/// The file of a prefix with this ending.
pub fn with_ending(stem: &OsStr, ending: &str) -> PathBuf {
    let mut path = stem.to_owned();
    path.push(ending);
    path.into()
}

/// Refuses outputs that are also inputs, or that exist and must not be replaced. The error names
/// the first output, and suggests another `option`.
pub fn must_be_new<'a>(
    outputs: impl IntoIterator<Item = &'a PathBuf, IntoIter: Clone>,
    read: &[PathBuf],
    overwrite: bool,
    option: &str,
) -> Result<(), Error> {
    let outputs = outputs.into_iter();
    // Compares files instead of names.
    let read: Vec<PathBuf> = read
        .iter()
        .filter_map(|path| path.canonicalize().ok())
        .collect();
    for path in outputs.clone() {
        if path.canonicalize().is_ok_and(|there| read.contains(&there)) {
            let message = format!("{} is read itself", path.display());
            return Err(Error::usage(
                message,
                format!("name another file with `{option}`"),
            ));
        }
    }
    match outputs.into_iter().find(|path| !overwrite && path.exists()) {
        Some(path) => Err(Error::usage(
            format!("{} exists already", path.display()),
            format!("replace it with `--overwrite`, or name another file with `{option}`"),
        )),
        None => Ok(()),
    }
}

/// The content of a file.
pub enum Content<'a> {
    /// A `.npy` array.
    Array {
        /// Length of each axis.
        shape: Vec<usize>,
        /// Values, last axis fastest.
        values: &'a [f32],
    },
    /// A text.
    Text(String),
}

impl<'a> Content<'a> {
    /// Joint features `[T, C]`.
    pub fn features(features: &'a Features) -> Self {
        Self::Array {
            shape: vec![features.frames(), features.layout().channels()],
            values: features.as_slice(),
        }
    }
}

/// Writes all files. Fails if a file cannot be written, and removes the files before it.
pub fn write_all(files: &[(PathBuf, Content<'_>)]) -> Result<(), Error> {
    for (i, (path, content)) in files.iter().enumerate() {
        let written = match content {
            Content::Array { shape, values } => write_values(path, shape, values),
            Content::Text(text) => write_whole(path, text.as_bytes()),
        };
        if let Err(error) = written {
            for (path, _) in &files[..i] {
                let _ = fs::remove_file(path);
            }
            return Err(error.into());
        }
    }
    Ok(())
}
