//! Evaluations side by side, as a table, JSON and CSV.

use std::path::PathBuf;

use kinegrad_motion::Value;
use kinegrad_train::systems::cc_motion::evaluate::{Evaluation, Measures, ProfileRates};
use serde_json::json;

use crate::output::table;

/// Evaluations with a column for each run and one for the real phrases.
pub struct Comparison<'a> {
    evaluations: &'a [Evaluation],
    columns: Vec<Column<'a>>,
}

struct Column<'a> {
    label: String,
    /// Step, phrases and seeds; nothing for the real phrases but their number.
    counts: [Option<u64>; 3],
    processed: &'a Measures,
    raw: &'a Measures,
}

/// Names of [`Column::counts`].
const COUNTS: [&str; 3] = ["step", "phrases", "seeds"];

impl<'a> Comparison<'a> {
    /// The comparison of these evaluations, of which there is at least one. The columns are named
    /// after the runs or, where two runs have the same name, as the user named them in `paths`.
    pub fn new(paths: &[PathBuf], evaluations: &'a [Evaluation]) -> Self {
        let names: Vec<&str> = evaluations.iter().map(|each| each.run.as_str()).collect();
        let distinct = (1..names.len()).all(|index| !names[..index].contains(&names[index]));
        let labels: Vec<String> = match distinct {
            true => names.iter().map(|name| name.to_string()).collect(),
            false => paths
                .iter()
                .map(|path| path.display().to_string())
                .collect(),
        };
        let real = |label: String, evaluation: &'a Evaluation| Column {
            label,
            counts: [None, Some(evaluation.phrases as u64), None],
            processed: &evaluation.real,
            raw: &evaluation.real,
        };
        let same = evaluations
            .iter()
            .all(|evaluation| evaluation.real == evaluations[0].real);
        let mut columns = Vec::new();
        for (label, evaluation) in labels.iter().zip(evaluations) {
            columns.push(Column {
                label: label.clone(),
                counts: [
                    Some(evaluation.step),
                    Some(evaluation.phrases as u64),
                    Some(evaluation.settings.seeds as u64),
                ],
                processed: &evaluation.processed,
                raw: &evaluation.raw,
            });
            // Runs with other held-out phrases, or other training phrases to measure in units of.
            if !same {
                columns.push(real(format!("real ({label})"), evaluation));
            }
        }
        if same {
            columns.push(real("real".to_string(), &evaluations[0]));
        }
        Self {
            evaluations,
            columns,
        }
    }

    /// All numbers: `{"evaluations": [...]}`, one object for each run.
    pub fn json(&self) -> String {
        let report = json!({ "evaluations": self.evaluations });
        serde_json::to_string_pretty(&report).expect("an evaluation is plain data")
    }

    /// All numbers, a line each: whether of the samples as post-processed or raw, its name, the
    /// runs, the real phrases. A number that is missing leaves its field empty.
    pub fn csv(&self) -> String {
        let labels = self.columns.iter().map(|column| field(&column.label));
        let mut lines = vec![line(["samples", "measure"], labels)];
        for (index, name) in COUNTS.into_iter().enumerate() {
            let counts = self.columns.iter().map(|column| {
                let count = column.counts[index];
                count.map_or_else(String::new, |count| count.to_string())
            });
            lines.push(line(["", name], counts));
        }
        for form in [Form::Processed, Form::Raw] {
            let columns = self.columns.iter().map(|column| numbers(column.of(form)));
            let columns: Vec<Vec<(String, Option<f64>)>> = columns.collect();
            let named = columns.iter().flatten().map(|(name, _)| name.as_str());
            for name in distinct(named) {
                let values = columns.iter().map(|numbers| {
                    let found = numbers.iter().find(|(other, _)| other == name);
                    let value = found.and_then(|(_, value)| *value);
                    value.map_or_else(String::new, |value| value.to_string())
                });
                lines.push(line([form.key(), name], values));
            }
        }
        lines.concat()
    }

    /// All numbers for people: of checks the share that passes and the mean value.
    pub fn table(&self) -> String {
        let mut rows = vec![self.row("", |column| column.label.clone())];
        for (index, name) in COUNTS.into_iter().enumerate() {
            rows.push(self.row(name, |column| match column.counts[index] {
                Some(count) => count.to_string(),
                None => MISSING.to_string(),
            }));
        }
        for form in [Form::Processed, Form::Raw] {
            rows.push(self.row(form.title(), |_| String::new()));
            for metric in &METRICS {
                rows.push(
                    self.row(metric.title, |column| match (metric.of)(column.of(form)) {
                        Some(value) => format!("{value:.*}", metric.decimals),
                        None => MISSING.to_string(),
                    }),
                );
            }
            let losses = self
                .columns
                .iter()
                .flat_map(|column| &column.of(form).losses);
            for name in distinct(losses.map(|loss| loss.name)) {
                rows.push(self.row(&format!("loss: {name}"), |column| {
                    let mut losses = column.of(form).losses.iter();
                    match losses.find(|loss| loss.name == name) {
                        Some(loss) => format!("{:.3e}", loss.value),
                        None => MISSING.to_string(),
                    }
                }));
            }
            for (profile, rates) in PROFILES {
                rows.push(self.row(&format!("{profile}: all"), |column| {
                    percent(rates(column.of(form)).pass_rate)
                }));
                let all = self.columns.iter().map(|column| rates(column.of(form)));
                let checks = all.flat_map(|rates| &rates.checks);
                for name in distinct(checks.map(|check| check.name)) {
                    rows.push(self.row(&format!("{profile}: {name}"), |column| {
                        match rates(column.of(form)).check(name) {
                            Some(check) => {
                                format!("{} ({})", percent(check.pass_rate), check.value)
                            }
                            None => MISSING.to_string(),
                        }
                    }));
                }
            }
        }
        table(rows)
    }

    fn row(&self, title: &str, cell: impl Fn(&Column) -> String) -> Vec<String> {
        let cells = self.columns.iter().map(cell);
        std::iter::once(title.to_string()).chain(cells).collect()
    }
}

/// Stands in the table for a number that cannot be computed or does not apply.
const MISSING: &str = "-";

/// Which of the two forms of the samples.
#[derive(Clone, Copy)]
enum Form {
    Processed,
    Raw,
}

impl Form {
    fn key(self) -> &'static str {
        match self {
            Self::Processed => "processed",
            Self::Raw => "raw",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Processed => "POST-PROCESSED",
            Self::Raw => "RAW",
        }
    }
}

impl Column<'_> {
    fn of(&self, form: Form) -> &Measures {
        match form {
            Form::Processed => self.processed,
            Form::Raw => self.raw,
        }
    }
}

struct Metric {
    key: &'static str,
    title: &'static str,
    decimals: usize,
    of: fn(&Measures) -> Option<f64>,
}

const METRICS: [Metric; 6] = [
    Metric {
        key: "diversity",
        title: "diversity",
        decimals: 3,
        of: |measures| measures.diversity,
    },
    Metric {
        key: "same_phrase_diversity",
        title: "same-phrase diversity",
        decimals: 3,
        of: |measures| measures.same_phrase_diversity,
    },
    Metric {
        key: "frechet_held_out",
        title: "Fréchet to held-out",
        decimals: 4,
        of: |measures| measures.frechet_held_out,
    },
    Metric {
        key: "frechet_training",
        title: "Fréchet to training",
        decimals: 4,
        of: |measures| measures.frechet_training,
    },
    Metric {
        key: "beat_alignment",
        title: "beat alignment",
        decimals: 3,
        of: |measures| measures.beat_alignment,
    },
    Metric {
        key: "mean_jerk",
        title: "mean jerk, m/s^3",
        decimals: 1,
        of: |measures| measures.mean_jerk,
    },
];

type Rates = fn(&Measures) -> &ProfileRates;

const PROFILES: [(&str, Rates); 2] = [
    ("document", |measures| &measures.document),
    ("strict", |measures| &measures.strict),
];

/// Every number by its path in the JSON; a value that is not finite counts as missing.
fn numbers(measures: &Measures) -> Vec<(String, Option<f64>)> {
    let mut numbers: Vec<(String, Option<f64>)> = METRICS
        .iter()
        .map(|metric| (metric.key.to_string(), (metric.of)(measures)))
        .collect();
    for loss in &measures.losses {
        let value = loss.value.is_finite().then_some(loss.value);
        numbers.push((format!("loss.{}", loss.name), value));
    }
    for (profile, rates) in PROFILES {
        let rates = rates(measures);
        let mut add = |name: String, value: f64| {
            let name = format!("{profile}.{name}");
            numbers.push((name, value.is_finite().then_some(value)));
        };
        add("pass_rate".to_string(), rates.pass_rate);
        for check in &rates.checks {
            let name = check.name;
            add(format!("{name}.pass_rate"), check.pass_rate);
            match check.value {
                Value::Number(value) => add(format!("{name}.value"), value),
                Value::Range([low, high]) => {
                    add(format!("{name}.min"), low);
                    add(format!("{name}.max"), high);
                }
            }
        }
    }
    numbers
}

/// Each name once, in the order in which they first come.
fn distinct<'a>(names: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = Vec::new();
    for name in names {
        if !seen.contains(&name) {
            seen.push(name);
        }
    }
    seen
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn line(head: [&str; 2], fields: impl Iterator<Item = String>) -> String {
    let fields: Vec<String> = head.map(String::from).into_iter().chain(fields).collect();
    fields.join(",") + "\n"
}

/// A field of a CSV file, in quotes where it needs them (RFC 4180).
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::{distinct, field};

    #[test]
    fn fields_are_quoted_where_they_need_it() {
        for (text, quoted) in [
            ("run", "run"),
            ("a run", "a run"),
            ("one, two", "\"one, two\""),
            ("the \"best\"", "\"the \"\"best\"\"\""),
        ] {
            assert_eq!(field(text), quoted);
        }
    }

    #[test]
    fn names_keep_their_first_place() {
        assert_eq!(distinct(["b", "a", "b", "c"].into_iter()), ["b", "a", "c"]);
    }
}
