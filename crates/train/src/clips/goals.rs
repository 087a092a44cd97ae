//! Reading goals.

use std::fmt::Display;
use std::path::Path;

use kinegrad_data::Digest;
use kinegrad_data::file::read_text;
use kinegrad_motion::goal::Goal;
use kinegrad_settings::{in_words, must_be_finite, must_be_tables};
use toml::Table;

use crate::config::{PLAIN, line_of};
use crate::error::Error;

/// Reads a goal.
///
/// # Errors
/// Names the file, the key, what was found and what is allowed.
pub fn read_goal(path: &Path) -> Result<Goal, Error> {
    Ok(read_goal_and_digest(path)?.0)
}

/// Reads a goal, with the checksum of its file.
///
/// # Errors
/// As [`read_goal`].
pub(crate) fn read_goal_and_digest(path: &Path) -> Result<(Goal, Digest), Error> {
    let refused = |reason: &dyn Display| {
        let message = format!("{}: {reason}", path.display());
        Error::usage(message, "docs/goals.md describes goals")
    };
    let text = read_text(path).map_err(|error| refused(&error))?;
    let no_goal = |error: toml::de::Error| {
        let line = error.span().map_or(1, |span| line_of(&text, span.start));
        let written = text.lines().nth(line - 1).unwrap_or_default();
        let written: String = written.trim().chars().take(60).collect();
        let problem = in_words(error.message());
        refused(&format!("line {line}, `{written}`: {problem}"))
    };
    let given: Table = text.parse().map_err(no_goal)?;
    let goal: Goal = toml::from_str(&text).map_err(no_goal)?;
    let read = Table::try_from(&goal).expect(PLAIN);
    must_be_finite(&given)
        .and_then(|()| must_be_tables(&given, &read))
        .map_err(|unfit| refused(&unfit))?;
    goal.validate().map_err(|error| refused(&error))?;
    Ok((goal, Digest::of(text.as_bytes())))
}
