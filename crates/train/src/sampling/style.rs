//! The style condition of a sample.

use kinegrad_data::STYLE_NUMBERS;
use serde::{Deserialize, Serialize};

use crate::error::Error;

/// A style.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Style {
    /// The eight style numbers, in the units of the motion's style channels.
    Numbers([f64; STYLE_NUMBERS]),
    /// A label, such as `waltz`.
    Label(String),
}

impl Style {
    /// Parses a style: eight numbers with commas between them, or a label.
    ///
    /// # Errors
    /// [`Error::Usage`] for an empty text, or numbers that are not eight finite numbers.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let numbers: Vec<Option<f64>> = parts.iter().map(|part| part.parse().ok()).collect();
        if let [part] = parts[..]
            && numbers == [None]
            && !part.is_empty()
        {
            return Ok(Self::Label(part.to_owned()));
        }
        match numbers.iter().position(Option::is_none) {
            Some(place) => Err(wrong(text, &format!("`{}` is not a number", parts[place]))),
            None => Self::numbers(&numbers.into_iter().flatten().collect::<Vec<_>>())
                .map_err(|problem| wrong(text, &problem)),
        }
    }

    /// The style of eight finite numbers.
    ///
    /// # Errors
    /// A description of the fault.
    pub fn numbers(numbers: &[f64]) -> Result<Self, String> {
        if let Some(odd) = numbers.iter().find(|number| !number.is_finite()) {
            return Err(format!("{odd} is not finite"));
        }
        let found = numbers.len();
        let eight = <[f64; STYLE_NUMBERS]>::try_from(numbers);
        let eight = eight.map_err(|_| format!("{found} numbers found"))?;
        Ok(Self::Numbers(eight))
    }
}

fn wrong(text: &str, problem: &str) -> Error {
    Error::usage(
        format!("option `style {text}`: {problem}"),
        "a label such as `waltz`, or eight numbers with commas between them, are allowed",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_style_is_a_label_or_eight_finite_numbers() {
        let parsed = |text: &str| Style::parse(text).expect(text);
        assert_eq!(parsed("waltz"), Style::Label("waltz".into()));
        assert_eq!(parsed(" slow waltz "), Style::Label("slow waltz".into()));
        let eight = [0.1, -0.2, 3.0, 4e-1, 5.0, 6.0, 7.0, 8.0];
        assert_eq!(parsed("0.1,-0.2, 3,4e-1,5,6,7,8"), Style::Numbers(eight));
        for (text, problem) in [
            ("", "`` is not a number"),
            ("1,2,3,4,5,6,7", "7 numbers found"),
            ("1,2,3,4,5,6,7,8,9", "9 numbers found"),
            ("0.5", "1 numbers found"),
            ("1,2,3,nan,5,6,7,8", "NaN is not finite"),
            ("1,2,3,inf,5,6,7,8", "inf is not finite"),
            ("1,2,3,x,5,6,7,8", "`x` is not a number"),
            ("waltz,tango", "`waltz` is not a number"),
        ] {
            let error = Style::parse(text).expect_err(text).to_string();
            assert!(error.contains(problem), "{text}: {error}");
            assert!(
                error.starts_with(&format!("option `style {text}`")),
                "{error}"
            );
        }
    }

    #[test]
    fn records_write_a_word_or_an_array() {
        let label = Style::Label("waltz".into());
        let numbers = Style::Numbers([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.5]);
        for (style, text) in [
            (label, "\"waltz\""),
            (numbers, "[0.0,1.0,2.0,3.0,4.0,5.0,6.0,7.5]"),
        ] {
            assert_eq!(serde_json::to_string(&style).expect("plain"), text);
            let read: Style = serde_json::from_str(text).expect("the same");
            assert_eq!(read, style);
        }
    }
}
