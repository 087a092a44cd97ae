use kinegrad_settings::{DocumentError, InvalidSetting};
use miette::Diagnostic;
use thiserror::Error;

use crate::humanml::FeatureError;

/// An error about a path or a motion that follows one.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum PathError {
    /// A path has fewer than two points.
    #[error("a path has {found} points, at least 2 are needed")]
    #[diagnostic(help("give its begin and its end, `[x, z]` in metres"))]
    TooFewPoints {
        /// Points found.
        found: usize,
    },

    /// A point is out of range.
    #[error("point {index} of the path (counted from 0) is [{x}, {z}], allowed: -5000 to 5000 m")]
    #[diagnostic(help("points are `[x, z]` in metres, at most 5 km from the origin"))]
    NotAPoint {
        /// The point.
        index: usize,
        /// Its first coordinate.
        x: f64,
        /// Its second coordinate.
        z: f64,
    },

    /// All points of a path are the same.
    #[error("all points of the path are the same: it has no length")]
    #[diagnostic(help("points are `[x, z]` in metres"))]
    NoLength,

    /// A TOML file that is refused.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Document(#[from] DocumentError),

    /// A table or drawing that cannot be read.
    #[error("{file}: {problem}")]
    #[diagnostic(help("docs/paths.md describes paths"))]
    File {
        /// The file.
        file: String,
        /// The line, what was found, and what is allowed.
        problem: String,
    },

    /// A setting out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),

    /// A motion that does not fit.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Features(#[from] FeatureError),
}
