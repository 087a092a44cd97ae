//! What can be wrong with a goal.

use miette::Diagnostic;
use thiserror::Error;

/// An error about what a user asks the motion to do.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum GoalError {
    /// A value of the goal or of a setting cannot be followed.
    #[error("`{key}` is {found}, allowed: {allowed}")]
    #[diagnostic(help("{hint}"))]
    Invalid {
        /// The value's place, such as `keyframe[2].frame`; lists count from 0.
        key: String,
        /// The value found.
        found: String,
        /// What is allowed, in words.
        allowed: String,
        /// What to do.
        hint: &'static str,
    },

    /// There are neither key frames nor a trajectory nor obstacles.
    #[error("the goal asks for nothing")]
    #[diagnostic(help("add a `[[keyframe]]`, a `[trajectory]` or an `[[obstacle]]`"))]
    NothingToDo,
}

/// Refuses a number that is NaN or infinite, or that `admits` does not like.
pub(super) fn check_number(
    key: impl FnOnce() -> String,
    number: f64,
    admits: impl FnOnce(f64) -> bool,
    allowed: &'static str,
    hint: &'static str,
) -> Result<(), GoalError> {
    match number.is_finite() && admits(number) {
        true => Ok(()),
        false => Err(invalid(key(), number, allowed, hint)),
    }
}

/// A [`GoalError::Invalid`].
pub(super) fn invalid(
    key: impl Into<String>,
    found: impl ToString,
    allowed: impl Into<String>,
    hint: &'static str,
) -> GoalError {
    GoalError::Invalid {
        key: key.into(),
        found: found.to_string(),
        allowed: allowed.into(),
        hint,
    }
}

/// Refuses a ground position that is not finite; `key` is that of its two numbers' parent.
pub(super) fn check_position(
    key: impl Fn() -> String,
    position: [f64; 2],
) -> Result<(), GoalError> {
    for (axis, value) in ["x", "z"].into_iter().zip(position) {
        check_number(
            || format!("{}.{axis}", key()),
            value,
            |_| true,
            "a finite number of metres",
            "positions lie on the ground, x to the left of the first frame's body and z ahead of it",
        )?;
    }
    Ok(())
}
