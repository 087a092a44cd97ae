//! Results of the checks.

use std::fmt;

use serde::Serialize;

/// The outcome of all checks of a phrase.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The checks in the order of the profile.
    pub checks: Vec<Check>,
    /// True if all checks passed.
    pub passed: bool,
}

impl Report {
    /// The report of these checks.
    pub fn new(checks: Vec<Check>) -> Self {
        let passed = checks.iter().all(|check| check.passed);
        Self { checks, passed }
    }

    /// The check named `name`.
    pub fn check(&self, name: &str) -> Option<&Check> {
        self.checks.iter().find(|check| check.name == name)
    }
}

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// True if the value lies within the threshold.
    pub passed: bool,
    /// The measured value, in the units of the check.
    pub value: Value,
    /// The allowed values.
    pub threshold: Threshold,
    /// The measurement in words.
    pub message: String,
}

impl Check {
    /// A check that passes if the threshold allows the value.
    pub fn new(
        name: &'static str,
        value: impl Into<Value>,
        threshold: Threshold,
        message: String,
    ) -> Self {
        let value = value.into();
        Self {
            name,
            passed: threshold.admits(value),
            value,
            threshold,
            message,
        }
    }

    /// The outcome with the larger excess over the threshold.
    pub fn worse(self, other: Self) -> Self {
        let excess = |check: &Self| check.threshold.excess(check.value);
        // NaN is the worst.
        match excess(&self) >= excess(&other) || excess(&self).is_nan() {
            true => self,
            false => other,
        }
    }
}

/// A measurement. In JSON a number or a pair of numbers (`null` for values that are not finite).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A single number.
    Number(f64),
    /// Smallest and largest of many.
    Range([f64; 2]),
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

/// Allowed values of a check. In JSON an object such as `{"below": 5.0}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Threshold {
    /// Less than the number.
    Below(f64),
    /// Less than the number or equal to it.
    AtMost(f64),
    /// More than the number.
    Above(f64),
    /// More than the number or equal to it.
    AtLeast(f64),
    /// Between the numbers, both included.
    Within([f64; 2]),
}

impl Threshold {
    /// True if the value (both ends of a range) is allowed. NaN is not allowed.
    pub fn admits(self, value: Value) -> bool {
        let admits = |value: f64| match self {
            Self::Below(bound) => value < bound,
            Self::AtMost(bound) => value <= bound,
            Self::Above(bound) => value > bound,
            Self::AtLeast(bound) => value >= bound,
            Self::Within([low, high]) => low <= value && value <= high,
        };
        match value {
            Value::Number(number) => admits(number),
            Value::Range([low, high]) => admits(low) && admits(high),
        }
    }

    /// Excess of the value (the worse end of a range) over the bound, negative within the bound.
    fn excess(self, value: Value) -> f64 {
        let excess = |value: f64| match self {
            Self::Below(bound) | Self::AtMost(bound) => value - bound,
            Self::Above(bound) | Self::AtLeast(bound) => bound - value,
            Self::Within([low, high]) if value.is_nan() => low + high + value,
            Self::Within([low, high]) => (low - value).max(value - high),
        };
        match value {
            Value::Number(number) => excess(number),
            Value::Range([low, high]) => match [excess(low), excess(high)] {
                [low, high] if !low.is_nan() && (high > low || high.is_nan()) => high,
                [low, _] => low,
            },
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => f.write_str(&short(*number)),
            Self::Range([low, high]) => write!(f, "[{}, {}]", short(*low), short(*high)),
        }
    }
}

impl fmt::Display for Threshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Below(bound) => write!(f, "< {}", short(*bound)),
            Self::AtMost(bound) => write!(f, "<= {}", short(*bound)),
            Self::Above(bound) => write!(f, "> {}", short(*bound)),
            Self::AtLeast(bound) => write!(f, ">= {}", short(*bound)),
            Self::Within([low, high]) => write!(f, "[{}, {}]", short(*low), short(*high)),
        }
    }
}

/// About four digits.
fn short(number: f64) -> String {
    match number.abs() {
        size if !number.is_finite() || (1e6..).contains(&size) => format!("{number:.3e}"),
        size if size >= 1000.0 || number.fract() == 0.0 => format!("{number:.0}"),
        size if size >= 10.0 => format!("{number:.2}"),
        size if size >= 1e-3 => format!("{number:.4}"),
        _ => format!("{number:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_admit_their_values() {
        let admits = |threshold: Threshold| {
            [0.9, 1.0, 1.1, 2.0, 2.1].map(|value| threshold.admits(Value::Number(value)))
        };
        assert_eq!(
            admits(Threshold::Below(1.0)),
            [true, false, false, false, false]
        );
        assert_eq!(
            admits(Threshold::AtMost(1.0)),
            [true, true, false, false, false]
        );
        assert_eq!(
            admits(Threshold::Above(1.0)),
            [false, false, true, true, true]
        );
        assert_eq!(
            admits(Threshold::Within([1.0, 2.0])),
            [false, true, true, true, false]
        );
        let within = Threshold::Within([0.0, 1.0]);
        assert!(within.admits(Value::Range([0.0, 1.0])));
        assert!(!within.admits(Value::Range([-0.1, 1.0])));
        assert!(!within.admits(Value::Range([0.0, 1.1])));
    }

    #[test]
    fn nan_is_never_admitted() {
        let thresholds = [
            Threshold::Below(1.0),
            Threshold::AtMost(1.0),
            Threshold::Above(1.0),
            Threshold::Within([0.0, 1.0]),
        ];
        for threshold in thresholds {
            assert!(!threshold.admits(Value::Number(f64::NAN)));
            assert!(!threshold.admits(Value::Range([f64::NAN, 0.5])));
            assert!(!threshold.admits(Value::Range([0.5, f64::NAN])));
        }
    }

    #[test]
    fn numbers_are_readable_at_every_size() {
        let shown = [
            0.0,
            1.0,
            0.95,
            124.4019,
            50000.0,
            5.1e-7,
            0.07208,
            1.2e9,
            f64::NAN,
        ]
        .map(short);
        let expected = [
            "0", "1", "0.9500", "124.40", "50000", "5.1e-7", "0.0721", "1.200e9", "NaN",
        ];
        assert_eq!(shown, expected);
        assert_eq!(Threshold::Within([0.0, 1.0]).to_string(), "[0, 1]");
    }

    #[test]
    fn a_report_is_machine_readable() {
        let check = Check::new(
            "phase",
            Value::Range([0.0, 2.0]),
            Threshold::Within([0.0, 1.0]),
            "x".into(),
        );
        let report = serde_json::to_value(Report::new(vec![check])).unwrap();
        let expected = serde_json::json!({
            "checks": [{
                "name": "phase",
                "passed": false,
                "value": [0.0, 2.0],
                "threshold": {"within": [0.0, 1.0]},
                "message": "x",
            }],
            "passed": false,
        });
        assert_eq!(report, expected);
    }
}
