//! The verdict and the main measures of an evaluation.

use kinegrad_report::rows_within;
use kinegrad_train::evaluation::{Column, Evaluated, Number, best_columns};

/// Placeholder of a missing value.
const MISSING: &str = "-";

/// The sentences of the verdict: in how many measures each of several runs alone is best, then each
/// run's own.
pub fn verdict(labels: &[String], all: &[Evaluated]) -> Vec<String> {
    let best = best(all);
    let measures = best.iter().filter(|places| places.len() == 1).count();
    let wins = |run: usize| best.iter().filter(|places| places[..] == [run]).count();
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by_key(|&run| std::cmp::Reverse(wins(run)));
    let each = order
        .iter()
        .map(|&run| format!("{} in {}", labels[run], wins(run)));
    let each: Vec<String> = each.collect();
    let mut lines = Vec::new();
    match (all.len(), measures) {
        (1, _) => {}
        (_, 0) => lines.push("no run is the best in a measure".to_owned()),
        (_, 1) => lines.push(format!("best in one measure: {}", labels[order[0]])),
        _ => lines.push(format!("best of {measures} measures: {}", each.join(", "))),
    }
    for (label, each) in labels.iter().zip(all) {
        let said = each.verdict.iter();
        lines.extend(said.map(|said| format!("{label}: {said}")));
    }
    lines
}

fn best(all: &[Evaluated]) -> Vec<Vec<usize>> {
    let samples: Vec<&Column> = all.iter().map(|each| &each.samples).collect();
    let real: Vec<&Column> = all.iter().map(|each| &each.real).collect();
    best_columns(&samples, &real)
}

/// The main measures of the runs and of real motion, with their groups and directions; `*` marks the
/// best of several runs.
pub fn table(labels: &[String], all: &[Evaluated], width: Option<usize>) -> String {
    let same = all.iter().all(|each| each.real == all[0].real);
    let mut header = vec![String::new()];
    for label in labels {
        header.push(label.clone());
        header.extend((!same).then(|| format!("real ({label})")));
    }
    header.extend(same.then(|| "real".to_owned()));
    header.push(super::BETTER.to_owned());
    let mut rows = vec![header];
    let best = best(all);
    // Without the interval or the range, in brackets.
    let shown = |number: Option<&Number>| {
        let shown = number.and_then(|number| number.line.as_ref()?.1.as_deref());
        let shown = shown.map(|shown| shown.split(" (").next().unwrap_or(shown));
        shown.unwrap_or(MISSING).to_owned()
    };
    for ((group, number), best) in all[0].samples.main().zip(best) {
        let title = number
            .line
            .as_ref()
            .map_or(&number.name, |(title, _)| title);
        let title = match group.title {
            "" => title.clone(),
            of => format!("{}: {title}", of.to_lowercase()),
        };
        let mut row = vec![title];
        let of = |column: &Column| shown(column.number(group.key, &number.name));
        for (run, each) in all.iter().enumerate() {
            let mark = if best.contains(&run) { "* " } else { "" };
            row.push(format!("{mark}{}", of(&each.samples)));
            row.extend((!same).then(|| of(&each.real)));
        }
        row.extend(same.then(|| of(&all[0].real)));
        row.push(number.better.map_or("", |better| better.name()).to_owned());
        rows.push(row);
    }
    rows_within(rows, width)
}
