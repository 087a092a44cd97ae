//! Evaluations side by side, as a table, JSON and CSV.

use std::path::PathBuf;

use kinegrad_train::evaluation::{Column, Evaluated, Group};
use serde_json::json;

use crate::output::table;

/// Evaluations with a column for each run and one for real motion.
pub struct Comparison<'a> {
    evaluations: &'a [Evaluated],
    columns: Vec<(String, &'a Column)>,
}

/// Stands in the table for a number that cannot be computed or does not apply.
const MISSING: &str = "-";

impl<'a> Comparison<'a> {
    /// The comparison of these evaluations, of which there is at least one. The columns are named
    /// after the runs or, where two runs have the same name, as the user named them in `paths`.
    pub fn new(paths: &[PathBuf], evaluations: &'a [Evaluated]) -> Self {
        let names: Vec<&str> = evaluations.iter().map(|each| each.run.as_str()).collect();
        let distinct = (1..names.len()).all(|index| !names[..index].contains(&names[index]));
        let labels: Vec<String> = match distinct {
            true => names.iter().map(|name| name.to_string()).collect(),
            false => paths
                .iter()
                .map(|path| path.display().to_string())
                .collect(),
        };
        let mut each = evaluations.iter();
        let same = each.all(|evaluation| evaluation.real == evaluations[0].real);
        let mut columns = Vec::new();
        for (label, evaluation) in labels.into_iter().zip(evaluations) {
            columns.push((label.clone(), &evaluation.drawn));
            // Runs with other held-out motion, or other training motion to measure in units of.
            if !same {
                columns.push((format!("real ({label})"), &evaluation.real));
            }
        }
        if same {
            columns.push(("real".to_string(), &evaluations[0].real));
        }
        Self {
            evaluations,
            columns,
        }
    }

    /// All numbers: `{"evaluations": [...]}`, one object for each run.
    pub fn json(&self) -> String {
        let all: Vec<_> = self.evaluations.iter().map(|each| &each.json).collect();
        let report = json!({ "evaluations": all });
        serde_json::to_string_pretty(&report).expect("an evaluation is plain data")
    }

    /// All numbers, a line each: its group (of phrases, whether post-processed or raw), its name,
    /// the runs, real motion. A number that is missing leaves its field empty.
    pub fn csv(&self) -> String {
        let mut csv = csv::Writer::from_writer(Vec::new());
        let mut line = |head: [&str; 2], fields: Vec<String>| {
            let head = head.map(String::from).into_iter();
            csv.write_record(head.chain(fields))
                .expect("written to memory");
        };
        let labels = self.columns.iter().map(|(label, _)| label.clone());
        line(["samples", "measure"], labels.collect());
        for name in self.facts() {
            line(["", name], self.fact(name, ""));
        }
        for (index, group) in self.groups() {
            let groups = || self.columns.iter().map(|(_, column)| &column.groups[index]);
            let named = groups().flat_map(|group| &group.numbers);
            for name in distinct(named.map(|(name, _)| name.as_str())) {
                let values = groups().map(|group| {
                    let found = group.numbers.iter().find(|(other, _)| other == name);
                    let value = found.and_then(|(_, value)| *value);
                    value.map_or_else(String::new, |value| value.to_string())
                });
                line([group.key, name], values.collect());
            }
        }
        let bytes = csv.into_inner().expect("written to memory");
        String::from_utf8(bytes).expect("text")
    }

    /// All numbers for people.
    pub fn table(&self) -> String {
        let labels = self.columns.iter().map(|(label, _)| label.clone());
        let mut rows = vec![row("", labels.collect())];
        for name in self.facts() {
            rows.push(row(name, self.fact(name, MISSING)));
        }
        for (index, group) in self.groups() {
            if !group.title.is_empty() {
                rows.push(row(group.title, vec![String::new(); self.columns.len()]));
            }
            let groups = || self.columns.iter().map(|(_, column)| &column.groups[index]);
            let titles = groups().flat_map(|group| &group.rows);
            for title in distinct(titles.map(|(title, _)| title.as_str())) {
                let cells: Vec<Option<String>> = groups()
                    .map(|group| {
                        let found = group.rows.iter().find(|(other, _)| other == title);
                        found.and_then(|(_, shown)| shown.clone())
                    })
                    .collect();
                let cells = cells.into_iter();
                let cells = cells.map(|cell| cell.unwrap_or_else(|| MISSING.to_string()));
                rows.push(row(title, cells.collect()));
            }
        }
        table(rows)
    }

    fn facts(&self) -> Vec<&'static str> {
        let facts = self.columns[0].1.facts.iter();
        facts.map(|(name, _)| *name).collect()
    }

    fn fact(&self, name: &str, missing: &str) -> Vec<String> {
        let counts = self.columns.iter().map(|(_, column)| {
            let fact = column.facts.iter().find(|(other, _)| *other == name);
            let count = fact.and_then(|(_, count)| *count);
            count.map_or_else(|| missing.to_string(), |count| count.to_string())
        });
        counts.collect()
    }

    fn groups(&self) -> impl Iterator<Item = (usize, &'a Group)> + use<'a> {
        self.columns[0].1.groups.iter().enumerate()
    }
}

fn row(title: &str, cells: Vec<String>) -> Vec<String> {
    std::iter::once(title.to_string()).chain(cells).collect()
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

#[cfg(test)]
mod tests {
    use super::distinct;

    #[test]
    fn names_keep_their_first_place() {
        assert_eq!(distinct(["b", "a", "b", "c"].into_iter()), ["b", "a", "c"]);
    }
}
