//! Combination of evaluations with several seeds.

use kinegrad_motion::metrics::replication_interval;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, from_value, to_value};

use super::{Metrics, Number, OnStep};
use crate::error::Error;

/// The results of `count` evaluations by `one`, with consecutive seeds from `seed` on.
///
/// # Errors
/// As `one`.
pub fn replicate<T>(
    count: usize,
    seed: u64,
    on_step: &mut OnStep<'_>,
    mut one: impl FnMut(u64, &mut OnStep<'_>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let replications = (0..count).map(|number| {
        one(seed.wrapping_add(number as u64), &mut |stage, done, all| {
            on_step(stage, number * all + done, count * all)
        })
    });
    replications.collect()
}

/// The means of replicated reports, with the half-width of each 95 % interval.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Replicated<T> {
    /// The mean of each metric, and the counts of the first report.
    #[serde(flatten)]
    pub mean: T,
    /// The [`replication_interval`] of each metric; `None` for a single report.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<T>,
}

impl<T: Serialize + DeserializeOwned> Replicated<T> {
    /// Combines the reports. A metric that a report lacks is missing.
    ///
    /// # Panics
    /// Panics without a report, or if a report is not a plain struct of numbers.
    pub fn of(reports: &[T]) -> Self {
        let tables = reports.iter().map(|report| match to_value(report) {
            Ok(Value::Object(table)) => table,
            _ => panic!("a report is a struct"),
        });
        let tables: Vec<Map<String, Value>> = tables.collect();
        let combined = |of: &dyn Fn(&[f64]) -> f64| -> T {
            let tables: Vec<&Map<String, Value>> = tables.iter().collect();
            from_value(combine(&tables, of)).expect("a report of the same kind")
        };
        Self {
            mean: combined(&mean),
            interval: (reports.len() > 1).then(|| combined(&replication_interval)),
        }
    }

    /// [`of`](Self::of) for optional reports; `None` if a report is missing.
    pub fn of_all(reports: impl Iterator<Item = Option<T>>) -> Option<Self> {
        let reports: Option<Vec<T>> = reports.collect();
        Some(Self::of(&reports?))
    }
}

impl<T: Metrics> Metrics for Replicated<T> {
    fn rows(&self) -> Vec<Number> {
        let mut rows = self.mean.rows();
        let intervals = self.interval.as_ref().map(T::rows).unwrap_or_default();
        for (row, interval) in rows.iter_mut().zip(intervals) {
            if let (Some((_, Some(shown))), Some(half)) = (&mut row.line, interval.value) {
                *shown = format!("{shown} ±{half:.4}");
            }
        }
        rows
    }
}

/// A table with the numbers of `tables` combined, recursively.
fn combine(tables: &[&Map<String, Value>], of: &dyn Fn(&[f64]) -> f64) -> Value {
    let combined = tables[0].iter().map(|(key, first)| {
        let all = tables.iter().map(|table| table.get(key));
        let all: Vec<&Value> = all.map(|value| value.unwrap_or(&Value::Null)).collect();
        let numbers: Option<Vec<f64>> = all.iter().map(|value| value.as_f64()).collect();
        let inner: Option<Vec<&Map<_, _>>> = all.iter().map(|value| value.as_object()).collect();
        let value = match (numbers, inner) {
            _ if first.is_u64() => first.clone(),
            (Some(numbers), _) => of(&numbers).into(),
            (None, Some(inner)) => combine(&inner, of),
            (None, None) => Value::Null,
        };
        (key.clone(), value)
    });
    Value::Object(combined.collect())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::metrics::GoalReport;
    use kinegrad_motion::metrics::text_motion::TextMotionReport;

    use super::*;

    #[test]
    fn tables_show_the_intervals_of_metrics_that_have_one() {
        let report = |error, jerk| GoalReport {
            average_error: Some(error),
            jerk,
            ..GoalReport::default()
        };
        let shown = |reports: &[GoalReport], name: &str| {
            let rows = Replicated::of(reports).rows();
            let row = rows.into_iter().find(|row| row.name == name);
            row.and_then(|row| row.line).expect("a row")
        };
        let both = [report(1.0, Some(2.0)), report(2.0, None)];
        let (title, error) = shown(&both, "average error");
        assert_eq!(title, "average error m");
        assert_eq!(error.expect("a mean"), "1.5000 ±0.6930");
        assert_eq!(shown(&both, "mean jerk").1, None);
        let one = shown(&both[..1], "average error").1;
        assert_eq!(one.expect("a mean"), "1.0000");
    }

    #[test]
    fn metrics_are_averaged_and_counts_are_not() {
        let report = |error, jerk| GoalReport {
            samples: 7,
            average_error: Some(error),
            jerk,
            ..GoalReport::default()
        };
        let reports = [
            report(1.0, Some(4.0)),
            report(3.0, None),
            report(2.0, Some(2.0)),
        ];
        let all = Replicated::of(&reports);
        assert_eq!(all.mean, report(2.0, None));
        let interval = all.interval.expect("several");
        let expected = 1.96 * (2.0f64 / 3.0).sqrt() / 3.0f64.sqrt();
        assert!((interval.average_error.unwrap() - expected).abs() < 1e-12);
        assert_eq!((interval.samples, interval.jerk), (7, None));
        let labelled = |accuracy| TextMotionReport {
            label_accuracy: [("style".to_owned(), Some(accuracy))].into(),
            ..TextMotionReport::default()
        };
        let all = Replicated::of(&[labelled(0.5), labelled(0.75)]);
        assert_eq!(all.mean, labelled(0.625));
        let one = Replicated::of(&reports[..1]);
        assert_eq!((one.mean, one.interval), (reports[0].clone(), None));
    }
}
