//! The columns of a report and of its table.

use kinegrad_motion::metrics::GoalReport;
use kinegrad_motion::metrics::text_motion::TextMotionReport;

/// The numbers of one set of motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Counts by name; `None` if not applicable.
    pub facts: Vec<(&'static str, Option<u64>)>,
    /// The metrics, in groups.
    pub groups: Vec<Group>,
}

impl Column {
    /// The main measures: each with its group.
    pub fn main(&self) -> impl Iterator<Item = (&Group, &Number)> {
        let groups = self.groups.iter();
        groups.flat_map(|group| {
            let main = group.numbers.iter();
            let main = main.filter(|number| number.better.is_some());
            main.map(move |number| (group, number))
        })
    }

    /// The number of this name in the group of this key.
    pub fn number(&self, group: &str, name: &str) -> Option<&Number> {
        let group = self.groups.iter().find(|each| each.key == group)?;
        group.numbers.iter().find(|number| number.name == name)
    }
}

/// Direction of a main measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// A lower value is better.
    Lower,
    /// A higher value is better.
    Higher,
    /// A value near that of real motion is better.
    NearReal,
}

impl Better {
    /// The direction of a [`name`](Self::name) in tables.
    pub fn named(name: &str) -> Option<Self> {
        let all = [Self::Lower, Self::Higher, Self::NearReal];
        all.into_iter().find(|better| better.name() == name)
    }

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lower => "lower",
            Self::Higher => "higher",
            Self::NearReal => "near real",
        }
    }

    /// A badness that orders values, with the value of `real` motion; `None` if a value is missing.
    pub fn badness(self, value: Option<f64>, real: Option<f64>) -> Option<f64> {
        let value = value?;
        match self {
            Self::Lower => Some(value),
            Self::Higher => Some(-value),
            Self::NearReal => Some(ratio(value, real?).map_or(f64::INFINITY, |r| r.ln().abs())),
        }
    }
}

/// Ratio of two values of one sign; `None` for others.
pub(super) fn ratio(value: f64, real: f64) -> Option<f64> {
    let ratio = value / real;
    (ratio > 0.0 && ratio.is_finite()).then_some(ratio)
}

/// A group of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its name in files.
    pub key: &'static str,
    /// Heading of the group in tables; empty if a table has only one group.
    pub title: &'static str,
    /// The numbers.
    pub numbers: Vec<Number>,
}

impl Group {
    /// A group of all rows of `metrics`.
    pub fn new(key: &'static str, title: &'static str, metrics: &dyn Metrics) -> Self {
        Self {
            key,
            title,
            numbers: metrics.rows(),
        }
    }
}

/// A number.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Its name in files.
    pub name: String,
    /// `None` if the number cannot be computed.
    pub value: Option<f64>,
    /// Row of the number in tables: a title and the number as text; `None` for files only.
    pub line: Option<(String, Option<String>)>,
    /// Direction of a main measure; `None` for other numbers.
    pub better: Option<Better>,
}

impl Number {
    /// A number that tables show with four decimals and its `unit` after the name.
    pub fn new(name: impl Into<String>, value: Option<f64>, unit: &str) -> Self {
        let name = name.into();
        let title = format!("{name}{unit}");
        let shown = value.map(|value| format!("{value:.4}"));
        Self::shown(name, value, title, shown)
    }

    /// [`new`](Self::new) for each name, value and unit.
    pub fn list<const N: usize>(rows: [(&str, Option<f64>, &str); N]) -> Vec<Self> {
        rows.map(|(name, value, unit)| Self::new(name, value, unit))
            .into()
    }

    /// A number that tables show as the text `shown`.
    pub fn shown(
        name: impl Into<String>,
        value: Option<f64>,
        title: impl Into<String>,
        shown: Option<String>,
    ) -> Self {
        Self {
            line: Some((title.into(), shown)),
            ..Self::in_files(name, value)
        }
    }

    /// A number that no table shows.
    pub fn in_files(name: impl Into<String>, value: Option<f64>) -> Self {
        Self {
            name: name.into(),
            value,
            line: None,
            better: None,
        }
    }

    /// Marks the main measures among `numbers`, by name, with their directions.
    pub fn mark(mut numbers: Vec<Self>, main: &[(&str, Better)]) -> Vec<Self> {
        for number in &mut numbers {
            let found = main.iter().find(|(name, _)| *name == number.name);
            number.better = found.map(|(_, better)| *better);
        }
        numbers
    }
}

/// Metrics of a set of motions.
pub trait Metrics {
    /// The numbers, in the order of tables.
    fn rows(&self) -> Vec<Number>;
}

impl<T: Metrics> Metrics for Vec<T> {
    fn rows(&self) -> Vec<Number> {
        self.iter().flat_map(Metrics::rows).collect()
    }
}

impl Metrics for GoalReport {
    fn rows(&self) -> Vec<Number> {
        let main = [
            ("trajectory error, 50 cm", Better::Lower),
            ("average error", Better::Lower),
            ("inside obstacles", Better::Lower),
            ("foot skating", Better::NearReal),
            ("mean jerk", Better::NearReal),
            ("fastest root step", Better::NearReal),
            ("diversity", Better::NearReal),
            ("Fréchet distance", Better::Lower),
        ];
        Number::mark(Number::list(GoalReport::rows(self)), &main)
    }
}

impl Metrics for TextMotionReport {
    fn rows(&self) -> Vec<Number> {
        let rows = TextMotionReport::rows(self).into_iter();
        let rows = rows.map(|(name, value)| Number::new(name, value, ""));
        let main = [
            ("R-precision, top 3", Better::Higher),
            ("multimodal distance", Better::NearReal),
            ("FID", Better::Lower),
            ("diversity", Better::NearReal),
        ];
        Number::mark(rows.collect(), &main)
    }
}
