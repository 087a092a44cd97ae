//! Reading and validation of settings, with error messages.
//!
//! ```
//! use kinegrad_settings::{Refused, in_range};
//! let refused = in_range("data.batch_size", 0usize, 1..=64)
//!     .hint("16 or 32 suit most runs")
//!     .unwrap_err();
//! assert_eq!(refused.to_string(), "`data.batch_size` is 0, allowed: 1 to 64");
//! ```

mod counts;
mod document;
mod keys;
mod words;

pub use counts::{counted, plural};
pub use document::{
    Document, DocumentError, Place, from_table, must_be_finite, must_be_tables, nearest, not_among,
    read_toml,
};
pub use keys::{Key, Name, Values, keys_of};

use std::fmt::Display;
use std::ops::{Bound, RangeBounds};

use miette::Diagnostic;
use thiserror::Error;

/// An invalid setting.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
#[error("`{key}` is {found}, allowed: {allowed}")]
#[diagnostic(help("{hint}"))]
pub struct InvalidSetting {
    /// The dotted key.
    pub key: String,
    /// The value found.
    pub found: String,
    /// The allowed values, in words.
    pub allowed: String,
    /// The remedy.
    pub hint: String,
}

impl InvalidSetting {
    /// An error with a general hint.
    pub fn new(key: impl Display, found: impl Display, allowed: impl Display) -> Self {
        Self {
            key: key.to_string(),
            found: found.to_string(),
            allowed: allowed.to_string(),
            hint: "`kinegrad config show CONFIG` prints every key with its value".into(),
        }
    }

    /// The same error with another hint.
    #[must_use]
    pub fn hint(self, hint: impl Into<String>) -> Self {
        Self {
            hint: hint.into(),
            ..self
        }
    }

    /// The same error for a key of `table`.
    #[must_use]
    pub fn within(self, table: &str) -> Self {
        Self {
            key: format!("{table}.{}", self.key),
            ..self
        }
    }
}

/// Details of the error of a setting.
pub trait Refused: Sized {
    /// Replaces the hint.
    #[must_use]
    fn hint(self, hint: impl Into<String>) -> Self;

    /// Prefixes the key with its table.
    #[must_use]
    fn within(self, table: &str) -> Self;
}

impl<T> Refused for Result<T, InvalidSetting> {
    fn hint(self, hint: impl Into<String>) -> Self {
        self.map_err(|refused| refused.hint(hint))
    }

    fn within(self, table: &str) -> Self {
        self.map_err(|refused| refused.within(table))
    }
}

/// Rejects a setting unless `holds` is true. Fails with [`InvalidSetting`] of `key`.
pub fn require(
    holds: bool,
    key: impl Display,
    found: impl Display,
    allowed: impl Display,
) -> Result<(), InvalidSetting> {
    match holds {
        true => Ok(()),
        false => Err(InvalidSetting::new(key, found, allowed)),
    }
}

/// Every number above 0.
pub const ABOVE_ZERO: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Unbounded);

/// Rejects a number that is outside `range` or not finite. Fails with [`InvalidSetting`] of `key`.
pub fn in_range<N: Number>(
    key: impl Display,
    number: N,
    range: impl RangeBounds<N>,
) -> Result<(), InvalidSetting> {
    let holds = number.is_finite() && range.contains(&number);
    let from = match range.start_bound() {
        Bound::Included(least) => format!("{least}"),
        Bound::Excluded(below) => format!("more than {below}"),
        Bound::Unbounded => "any number".into(),
    };
    let is_open = matches!(range.start_bound(), Bound::Unbounded);
    let allowed = match range.end_bound() {
        Bound::Included(most) if is_open => format!("at most {most}"),
        Bound::Included(most) => format!("{from} to {most}"),
        Bound::Excluded(above) => format!("{from} to below {above}"),
        Bound::Unbounded if matches!(range.start_bound(), Bound::Included(_)) => {
            format!("{from} or more")
        }
        Bound::Unbounded => from,
    };
    require(holds, key, number, allowed)
}

/// A number of a setting.
pub trait Number: Copy + Display + PartialOrd {
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool {
        true
    }
}

impl Number for f64 {
    fn is_finite(self) -> bool {
        self.is_finite()
    }
}

impl Number for usize {}

impl Number for u64 {}

impl Number for i64 {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_said_in_words() {
        let allowed = |refused: Result<(), InvalidSetting>| refused.unwrap_err().allowed;
        assert_eq!(allowed(in_range("k", 0usize, 1..)), "1 or more");
        assert_eq!(allowed(in_range("k", 9usize, 1..=8)), "1 to 8");
        assert_eq!(allowed(in_range("k", 1.0, 0.0..1.0)), "0 to below 1");
        assert_eq!(allowed(in_range("k", 0.0, ABOVE_ZERO)), "more than 0");
        for number in [f64::NAN, f64::INFINITY] {
            in_range("k", number, 0.0..).unwrap_err();
        }
        in_range("k", 0.0, 0.0..).unwrap();
    }

    #[test]
    fn an_error_says_key_value_range_and_remedy() {
        let refused = in_range("steps", 0usize, 1..)
            .hint("try 5")
            .within("rollout");
        let refused = refused.unwrap_err();
        assert_eq!(
            refused.to_string(),
            "`rollout.steps` is 0, allowed: 1 or more"
        );
        assert_eq!(Diagnostic::help(&refused).unwrap().to_string(), "try 5");
    }
}
