//! The evaluations of a run, or those of several runs side by side.

use std::cmp::Reverse;

use kinegrad_data::file::read_text;
use kinegrad_report::page::{Block, Cell, Section, Table, Tone, csv_table};
use kinegrad_train::evaluation::{Better, best_places};
use kinegrad_train::run::REPORTS;
use serde_json::Value;

use super::comparison::flattened;
use super::own_files;
use crate::commands::eval::BETTER;
use crate::io::file_stem;
use crate::runs::Run;

/// The name of real motion in a table's header.
const REAL: &str = "real";

/// Columns of a report beside the measures' names: run, real motion and direction.
const COLUMNS: usize = 3;

/// The settings of an evaluation: dotted keys with their values.
type Settings = Vec<(String, String)>;

/// The files of one report of `kinegrad eval`.
struct Report {
    stem: String,
    table: Option<Table>,
    json: Option<String>,
}

/// Reports of one evaluation, each of another run.
struct Group {
    /// `None` for files that are not the report of one run.
    settings: Option<Settings>,
    /// Each with the index of its run.
    reports: Vec<(usize, Report)>,
}

/// The reports of `kinegrad eval` in the folders of `runs`, whose names are `labels`. Evaluations of
/// equal settings are one table, with a column for each run.
pub fn section(runs: &[Run], labels: &[String]) -> Section {
    let mut section = Section::new("Evaluation");
    let mut groups: Vec<Group> = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        for report in reports(run, &mut section) {
            let settings = report.settings();
            let is_new = |group: &Group| group.reports.iter().all(|(own, _)| *own != index);
            let mut known = groups.iter_mut();
            let known = known.find(|group| group.settings == settings && is_new(group));
            match known.filter(|_| settings.is_some()) {
                Some(group) => group.reports.push((index, report)),
                None => groups.push(Group {
                    settings,
                    reports: vec![(index, report)],
                }),
            }
        }
    }
    // Comparisons come first.
    groups.sort_by_key(|group| Reverse(group.reports.len()));
    for group in &groups {
        group.show(&groups, labels, &mut section);
    }
    section
}

/// The reports in the folder of a run.
fn reports(run: &Run, section: &mut Section) -> Vec<Report> {
    let mut reports: Vec<Report> = Vec::new();
    for path in own_files(&run.folder, REPORTS, &["csv", "json"], section) {
        let text = match read_text(&path) {
            Ok(text) => text,
            Err(error) => {
                section.add(Block::Warning(format!("{}: {error}", path.display())));
                continue;
            }
        };
        let is_csv = path.extension().is_some_and(|ending| ending == "csv");
        let table = csv_table(&text).filter(|table| is_csv && !table.rows.is_empty());
        if is_csv && table.is_none() {
            let text = format!("{} is not a table", path.display());
            section.add(Block::Warning(text));
            continue;
        }
        let (stem, json) = (file_stem(&path), (!is_csv).then_some(text));
        match reports.iter_mut().find(|report| report.stem == stem) {
            Some(report) => {
                report.table = report.table.take().or(table);
                report.json = report.json.take().or(json);
            }
            None => reports.push(Report { stem, table, json }),
        }
    }
    reports
}

impl Report {
    fn parsed(&self) -> Value {
        let json = self.json.as_deref().unwrap_or_default();
        serde_json::from_str(json).unwrap_or_default()
    }

    /// The settings that the report states; `None` for files that are not the report of one run.
    fn settings(&self) -> Option<Settings> {
        let header = &self.table.as_ref()?.header;
        let parsed = self.parsed();
        let [evaluation] = &parsed["evaluations"].as_array()?[..] else {
            return None;
        };
        let [_, _, real, better] = &header[..] else {
            return None;
        };
        let of = &evaluation["evaluation"];
        if real != REAL || better != BETTER || !of.is_object() {
            return None;
        }
        let stated = parsed["settings"].as_object()?.clone();
        // The table of the evaluation has these keys too.
        let stated = stated.into_iter();
        let stated = stated.filter(|(key, _)| !key.starts_with("evaluation."));
        let all = serde_json::json!({
            "report": evaluation["report"],
            "evaluation": of,
        });
        let mut settings = flattened(all);
        settings.extend(flattened(Value::Object(stated.collect())));
        settings.sort();
        Some(settings)
    }

    /// The verdicts, each with the run's name.
    fn verdicts(&self) -> impl Iterator<Item = String> {
        let evaluations = self.parsed()["evaluations"].as_array().cloned();
        let evaluations = evaluations.unwrap_or_default().into_iter();
        evaluations.flat_map(|each| {
            let run = each["run"].as_str().unwrap_or_default().to_owned();
            let said = each["verdict"].as_array().cloned().unwrap_or_default();
            let said = said
                .into_iter()
                .filter_map(|said| said.as_str().map(String::from));
            said.map(move |said| format!("{run}: {said}"))
        })
    }
}

impl Group {
    /// The measures as a table, and the verdicts.
    fn show(&self, all: &[Self], labels: &[String], section: &mut Section) {
        let several = labels.len() > 1;
        let mut names: Vec<String> = Vec::new();
        for (run, report) in &self.reports {
            let name = match self.settings {
                None if several => format!("{}: {}", labels[*run], report.stem),
                _ => report.stem.clone(),
            };
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let table = self.table(labels);
        if table.is_some() {
            section.add(Block::Heading(names.join(", ")));
        }
        if several {
            section.add(Block::Text(self.differences(all)));
        }
        if let Some(table) = table {
            let main_rows = main_rows(&table);
            let complete = main_rows.rows.len() == table.rows.len();
            section.add(Block::Table(main_rows));
            if !complete {
                section.add(Block::Folded("every measure".into(), table));
            }
        }
        if self.settings.is_some() && several {
            let missing = labels.iter().enumerate();
            let missing = missing.filter(|(run, _)| self.reports.iter().all(|(own, _)| own != run));
            let missing: Vec<&str> = missing.map(|(_, label)| label.as_str()).collect();
            let missing = match missing.is_empty() {
                true => String::new(),
                false => format!("Not evaluated with these settings: {}.", missing.join(", ")),
            };
            section.add(Block::Text(missing));
        }
        for (_, report) in &self.reports {
            report
                .verdicts()
                .for_each(|said| section.add(Block::Text(said)));
            if let (Some(json), false) = (&report.json, several) {
                let title = format!("{}.json", report.stem);
                section.add(Block::Source(title, json.clone()));
            }
        }
    }

    /// The settings that differ from those of other evaluations of this kind.
    fn differences(&self, all: &[Self]) -> String {
        let kind = |settings: &Settings| {
            let mut settings = settings.iter();
            settings.find(|(key, _)| key == "report").cloned()
        };
        let Some(own) = &self.settings else {
            return String::new();
        };
        let others = all.iter().filter_map(|group| group.settings.as_ref());
        let others: Vec<&Settings> = others.filter(|other| kind(other) == kind(own)).collect();
        let differ = |pair: &&(String, String)| others.iter().any(|other| !other.contains(pair));
        let differ = own.iter().filter(differ);
        let differ: Vec<String> = differ
            .map(|(key, value)| format!("{key} = {value}"))
            .collect();
        match differ.is_empty() {
            true => String::new(),
            false => format!("Settings: {}.", differ.join(", ")),
        }
    }

    /// The measures of all runs, of real motion, and their directions. `*` marks the best of several
    /// runs.
    fn table(&self, labels: &[String]) -> Option<Table> {
        let mut tables = Vec::new();
        for (_, report) in &self.reports {
            tables.push(report.table.clone()?);
        }
        let Some(_) = self.settings else {
            let mut table = tables.swap_remove(0);
            table.shorten();
            return Some(table);
        };
        let full = Table::side_by_side(&tables);
        let mut short = full.clone();
        short.shorten();
        let labels: Vec<&str> = self
            .reports
            .iter()
            .map(|(run, _)| labels[*run].as_str())
            .collect();
        let measures = || full.rows.iter().filter(|row| row.len() > 1);
        let reports = || 0..tables.len();
        let column = |report: usize| 1 + COLUMNS * report;
        let same = measures().all(|row| reports().all(|own| row[column(own) + 1] == row[2]));
        let mut header = vec![full.header[0].clone()];
        for label in &labels {
            header.push((*label).to_owned());
            header.extend((!same).then(|| format!("{REAL} ({label})")));
        }
        header.extend(same.then(|| REAL.to_owned()));
        header.push(BETTER.to_owned());
        let row = |(full, short): (&Vec<Cell>, Vec<Cell>)| {
            if full.len() == 1 {
                return short;
            }
            let mut directions = reports().map(|own| &full[column(own) + 2]);
            let better = directions.find(|cell| !cell.text.is_empty()).cloned();
            let better = better.unwrap_or_default();
            let number = |cell: &Cell| cell.text.parse().ok();
            let values = reports().map(|own| [0, 1].map(|side| number(&full[column(own) + side])));
            let values: Vec<[Option<f64>; 2]> = values.collect();
            let best = Better::named(&better.text).map(|better| best_places(better, &values));
            let best = best.unwrap_or_default();
            let mut cells = vec![short[0].clone()];
            for own in reports() {
                let value = short[column(own)].clone();
                cells.push(match best.contains(&own) {
                    true => Cell::new(format!("* {}", value.text), Tone::Good),
                    false => value,
                });
                cells.extend((!same).then(|| short[column(own) + 1].clone()));
            }
            cells.extend(same.then(|| short[2].clone()));
            cells.push(better);
            cells
        };
        let rows = full.rows.iter().zip(short.rows).map(row);
        Some(Table {
            rows: rows.collect(),
            header,
        })
    }
}

/// The main measures: those with a direction, names without a dot, means with their intervals, and
/// pass rates.
fn main_rows(table: &Table) -> Table {
    let name = |row: &[Cell]| row.first().map_or("", |cell| &cell.text).to_owned();
    let has_directions = table.header.last().is_some_and(|last| last == BETTER);
    let rows = table.rows.iter().enumerate().filter_map(|(place, row)| {
        if row.len() == 1 {
            return Some(row.clone());
        }
        let full = name(row);
        let parts = full.split('.').count();
        let directed = has_directions && row.last().is_some_and(|cell| !cell.text.is_empty());
        let Some(of_mean) = full.strip_suffix(".mean") else {
            let is_main = parts == 1 || parts == 2 && full.ends_with("pass_rate");
            return (is_main || directed).then(|| row.clone());
        };
        let end = |place: usize, end: &str| {
            let row = table.rows.get(place)?;
            (name(row) == format!("{of_mean}.{end}")).then_some(row)
        };
        let ends = end(place + 1, "low").zip(end(place + 2, "high"));
        let cells = row.iter().enumerate().skip(1).map(|(column, mean)| {
            let ends = ends.and_then(|(low, high)| low.get(column).zip(high.get(column)));
            match ends.filter(|(low, _)| !low.text.is_empty()) {
                Some((low, high)) => {
                    let text = format!("{} ({} to {})", mean.text, low.text, high.text);
                    Cell::new(text, mean.tone)
                }
                None => mean.clone(),
            }
        });
        Some(std::iter::once(Cell::from(of_mean)).chain(cells).collect())
    });
    Table {
        header: table.header.clone(),
        rows: rows.collect(),
    }
}
