//! Several runs on one page.

use std::path::PathBuf;

use kinegrad_report::page::{Block, Cell, Page, Section, Table};
use kinegrad_train::telemetry::{Record, read_environments};
use serde_json::Value;

use super::curves::{Metrics, charts};
use super::{evaluation, facts, records};
use crate::runs::{Run, folder_name, labels};

/// Largest number of keys of the configs in the table.
const MOST_KEYS: usize = 200;

/// The curves of all runs together, their main facts, their evaluations and the differences of their
/// configs.
pub fn page(runs: &[Run]) -> Page {
    let folders: Vec<PathBuf> = runs.iter().map(|run| run.folder.clone()).collect();
    let names = runs.iter().map(|run| folder_name(&run.folder)).collect();
    let names = labels(names, &folders);
    let records: Vec<Vec<Record>> = runs.iter().map(records).collect();
    let metrics = names.iter().zip(&records);
    let metrics: Vec<Metrics<'_>> = metrics.map(|(name, own)| (&**name, &**own)).collect();
    let mut results = Section::new("Runs");
    results.add(Block::Table(main_facts(runs, &names, &records)));
    let mut training = Section::new("Training");
    training.add(Block::Charts(charts(&metrics)));
    let mut config = Section::new("Differences of the configs");
    config.add(Block::Table(differences(runs, &names)));
    let folders: Vec<String> = folders
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    Page {
        title: names.join(", "),
        subtitle: folders.join(", "),
        sections: vec![results, training, evaluation::section(runs, &names), config],
        ..Page::default()
    }
}

/// A table with a column for each run.
fn by_run(names: &[String], rows: Vec<Vec<Cell>>) -> Table {
    let header = std::iter::once(String::new()).chain(names.iter().cloned());
    Table {
        header: header.collect(),
        rows,
    }
}

/// One row per fact.
fn main_facts(runs: &[Run], names: &[String], records: &[Vec<Record>]) -> Table {
    let facts = runs.iter().zip(records).map(|(run, records)| {
        let environments = read_environments(&run.folder);
        let mut facts = vec![("state".to_string(), run.status.name().to_string())];
        facts.extend(facts::highlights(run, records, environments.last()));
        facts
    });
    let facts: Vec<Vec<(String, String)>> = facts.collect();
    let mut rows: Vec<&str> = Vec::new();
    for (name, _) in facts.iter().flatten() {
        if !rows.contains(&name.as_str()) {
            rows.push(name);
        }
    }
    let value = |facts: &Vec<(String, String)>, row: &str| {
        let found = facts.iter().find(|(name, _)| name == row);
        Cell::from(found.map_or("-", |(_, value)| value))
    };
    let row = |row: &str| {
        let values = facts.iter().map(|facts| value(facts, row));
        std::iter::once(Cell::from(row)).chain(values).collect()
    };
    by_run(names, rows.into_iter().map(row).collect())
}

/// One row per key that has not the same value in all runs.
fn differences(runs: &[Run], names: &[String]) -> Table {
    let configs: Vec<Vec<(String, String)>> = runs.iter().map(keys).collect();
    let mut all: Vec<&str> = Vec::new();
    for (key, _) in configs.iter().flatten() {
        all.push(key);
    }
    all.sort_unstable();
    all.dedup();
    let row = |key: &str| {
        let values = configs.iter().map(|config| {
            let found = config.iter().find(|(name, _)| name == key);
            found.map_or("-", |(_, value)| value)
        });
        let values: Vec<&str> = values.collect();
        let differ = values.iter().any(|value| *value != values[0]);
        let cells = std::iter::once(key).chain(values).map(Cell::from);
        differ.then(|| cells.collect())
    };
    by_run(
        names,
        all.into_iter().filter_map(row).take(MOST_KEYS).collect(),
    )
}

/// The keys of a config with their values, without its name.
fn keys(run: &Run) -> Vec<(String, String)> {
    let config = run.config.as_ref();
    let config = config.and_then(|config| serde_json::to_value(config).ok());
    let mut found = flattened(config.unwrap_or_default());
    found.retain(|(key, _)| key != "run.name");
    found
}

/// The dotted keys of a table with their values.
pub fn flattened(table: Value) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut waiting = vec![(String::new(), table)];
    while let Some((key, value)) = waiting.pop() {
        match value {
            Value::Object(table) => waiting.extend(table.into_iter().map(|(name, value)| {
                let dot = if key.is_empty() { "" } else { "." };
                (format!("{key}{dot}{name}"), value)
            })),
            Value::Null => {}
            value => found.push((key, value.to_string())),
        }
    }
    found
}
