//! Reading goals.

use std::path::Path;

use kinegrad_data::Digest;
use kinegrad_data::file::read_text;
use kinegrad_motion::goal::Goal;

use crate::error::Error;

/// Reads a goal and the checksum of its file.
///
/// # Errors
/// Names the file, the key, the value found and the allowed values.
pub fn read_goal(path: &Path) -> Result<(Goal, Digest), Error> {
    let file = path.display().to_string();
    let text = read_text(path).map_err(|error| {
        Error::usage(format!("{file}: {error}"), "docs/goals.md describes goals")
    })?;
    Ok((Goal::parse(&text, &file)?, Digest::of(text.as_bytes())))
}
