//! Length of a new motion.

use std::fmt::{self, Display};
use std::str::FromStr;

use serde::Serialize;

/// Length of a new motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "String")]
pub enum Length {
    /// A multiple of the length of all examples; written `2x`.
    Times(f64),
    /// Frames after downsampling; written `300`.
    Frames(usize),
    /// Seconds; written `12.5s`.
    Seconds(f64),
}

impl Length {
    /// The number of frames, where all examples have `examples` frames.
    pub fn frames(self, examples: usize, frame_time: f64) -> usize {
        match self {
            Self::Times(factor) => (factor * examples as f64).round() as usize,
            Self::Frames(frames) => frames,
            Self::Seconds(seconds) => (seconds / frame_time).round() as usize,
        }
    }
}

impl Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Times(factor) => write!(f, "{factor}x"),
            Self::Frames(frames) => write!(f, "{frames}"),
            Self::Seconds(seconds) => write!(f, "{seconds}s"),
        }
    }
}

impl From<Length> for String {
    fn from(length: Length) -> Self {
        length.to_string()
    }
}

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let parsed = text.trim().parse::<f64>().ok();
            parsed.filter(|number| number.is_finite() && *number > 0.0)
        };
        let parsed = match (text.strip_suffix('x'), text.strip_suffix('s')) {
            (Some(factor), _) => number(factor).map(Self::Times),
            (None, Some(seconds)) => number(seconds).map(Self::Seconds),
            (None, None) => text.parse().ok().map(Self::Frames),
        };
        let allowed = "allowed: times all examples, as 2x, frames, as 300, or seconds, as 12.5s";
        parsed.ok_or_else(|| allowed.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_read_as_they_are_written() {
        for (text, frames) in [("2x", 240), ("0.5x", 60), ("300", 300), ("2.5s", 75)] {
            let length: Length = text.parse().unwrap();
            assert_eq!(length.frames(120, 1.0 / 30.0), frames);
            assert_eq!(length.to_string(), text);
        }
        for text in ["x", "-1x", "0s", "1e999s", "2.5", "", "many"] {
            assert!(text.parse::<Length>().is_err(), "{text}");
        }
    }
}
