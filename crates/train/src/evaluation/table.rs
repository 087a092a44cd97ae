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
        }
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
        Number::list(GoalReport::rows(self))
    }
}

impl Metrics for TextMotionReport {
    fn rows(&self) -> Vec<Number> {
        let rows = TextMotionReport::rows(self).into_iter();
        rows.map(|(name, value)| Number::new(name, value, ""))
            .collect()
    }
}
