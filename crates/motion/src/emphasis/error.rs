//! Errors about an emphasis projection.

use kinegrad_settings::InvalidSetting;
use miette::Diagnostic;
use thiserror::Error;

/// An error about the settings or the matrix of an emphasis projection.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum EmphasisError {
    /// A setting is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),

    /// The matrix is not square.
    #[error(
        "the projection matrix has {values} values, which are not {dimension} rows of {dimension}"
    )]
    #[diagnostic(help(
        "give the square matrix that was trained with, row by row, as wide as the motion's features"
    ))]
    NotSquare {
        /// Number of values.
        values: usize,
        /// Number of features of a frame.
        dimension: usize,
    },

    /// The matrix contains NaN or an infinity.
    #[error(
        "the projection matrix is not finite in row {row}, column {column} (counted from 0): \
         {found}"
    )]
    #[diagnostic(help("the file of the matrix is damaged: fetch or export it again"))]
    NonFinite {
        /// Row of the first such value.
        row: usize,
        /// Column of that value.
        column: usize,
        /// The value.
        found: f32,
    },

    /// The matrix cannot be inverted in single precision.
    #[error(
        "the projection matrix is singular: its condition number is {condition_number:.1e}, \
         allowed: less than {limit:.1e}"
    )]
    #[diagnostic(help(
        "motion cannot be brought back from it; check that the matrix is complete, or use \
         another seed or a smaller `scale`"
    ))]
    Singular {
        /// Largest singular value divided by the smallest.
        condition_number: f64,
        /// The bound.
        limit: f64,
    },
}
