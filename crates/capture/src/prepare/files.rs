//! The files that plans name.

use std::path::{Path, PathBuf};

use kinegrad_data::file::read_file;
use kinegrad_data::matches;

/// The longest capture file: an hour of full-body marker data.
const MAX_BYTES: u64 = 2 << 30;

/// The bytes of a file of at most [`MAX_BYTES`].
pub(crate) fn bytes(path: &Path) -> Result<Vec<u8>, String> {
    read_file(path, MAX_BYTES).map_err(|problem| format!("{}: {problem}", path.display()))
}

/// The file that a pattern has found, as the plan would name it.
pub(crate) fn named(pattern: &str, found: &Path) -> String {
    let file = found.file_name().unwrap_or_default();
    let named = Path::new(pattern).with_file_name(file);
    named.to_string_lossy().into_owned()
}

/// The file at `path`, or the files that match a pattern in its name and have one of the `endings`:
/// sorted, at least one, without hidden files.
pub(crate) fn matching(path: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, String> {
    let missing = || format!("there is no file {}", path.display());
    let pattern = path.file_name().unwrap_or_default().to_string_lossy();
    if !pattern.contains('*') {
        return match path.is_file() {
            true => Ok(vec![path.to_owned()]),
            false => Err(missing()),
        };
    }
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let fits = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let ending = path.extension().unwrap_or_default();
        let mut known = endings.iter();
        matches(&pattern, &name)
            && !name.starts_with('.')
            && (endings.is_empty() || known.any(|known| ending.eq_ignore_ascii_case(known)))
            && path.is_file()
    };
    let entries = entries.flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries.filter(fits).collect();
    found.sort();
    if let Some(odd) = found.iter().find(|path| path.to_str().is_none()) {
        return Err(format!("{}: its name is not UTF-8", odd.display()));
    }
    if found.is_empty() {
        return Err(missing());
    }
    Ok(found)
}
