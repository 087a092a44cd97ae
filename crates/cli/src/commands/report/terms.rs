//! The loss of training and its terms, on logarithmic axes.

use kinegrad_report::{Panel, Series};
use kinegrad_train::telemetry::Record;

use super::curves::Metrics;

/// Most panels.
const MOST: usize = 6;

/// Prefixes of the terms in training and in validation.
const PREFIXES: [&str; 2] = ["loss_", "val_loss_"];

/// The terms that come first: those of the source's figure.
const FIRST: [&str; 5] = [
    "diffusion",
    "position",
    "velocity_coherence",
    "accel_coherence",
    "jerk",
];

/// The loss and the first of its terms, each in training and in validation.
pub fn term_charts(runs: &[Metrics<'_>]) -> Vec<Panel> {
    let terms = terms(runs);
    let most = MOST - 1;
    if terms.len() > most {
        let others = terms[most..].join(", ");
        tell!(
            "note: {MOST} of {} panels are shown, without {others}",
            terms.len() + 1
        );
    }
    let total = chart(runs, "total", ["loss", "val_loss"]);
    let terms = terms.iter().take(most).map(|term| {
        let [training, validation] = PREFIXES.map(|prefix| format!("{prefix}{term}"));
        chart(runs, term, [&training, &validation])
    });
    [total].into_iter().chain(terms).collect()
}

/// The names of all terms.
fn terms<'a>(runs: &[Metrics<'a>]) -> Vec<&'a str> {
    let mut terms: Vec<&str> = Vec::new();
    for (name, _) in runs
        .iter()
        .flat_map(|(_, records)| *records)
        .flat_map(|r| &r.scalars)
    {
        let term = PREFIXES.iter().find_map(|prefix| name.strip_prefix(prefix));
        terms.extend(term.filter(|term| !terms.contains(term)));
    }
    let place = |term: &&str| FIRST.iter().position(|first| first == term);
    terms.sort_by_key(|term| place(term).unwrap_or(FIRST.len()));
    terms
}

fn chart(runs: &[Metrics<'_>], title: &str, scalars: [&str; 2]) -> Panel {
    let mut series: Vec<Series> = Vec::new();
    for (run, records) in runs {
        for (scalar, kind) in scalars.into_iter().zip(["training", "validation"]) {
            let points = points(records, scalar);
            if !points.is_empty() {
                let name = match runs.len() {
                    1 => kind.to_owned(),
                    _ => format!("{run}, {kind}"),
                };
                series.push((name, points));
            }
        }
    }
    let mut values = series.iter().flat_map(|(_, points)| points);
    let title = match values.any(|(_, value)| *value > 0.0) {
        true => title.to_owned(),
        false => format!("{title}: 0 in every step"),
    };
    Panel::lines(title, "step", series).on_logarithmic_axis()
}

fn points(records: &[Record], name: &str) -> Vec<(f64, f64)> {
    let points = records.iter();
    let points = points.filter_map(|record| Some((record.step as f64, record.get(name)?)));
    points.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_total_and_the_terms_of_the_source_come_first() {
        let names = [
            "quaternion",
            "jerk",
            "accel_coherence",
            "position",
            "diffusion",
            "velocity_coherence",
            "phase_monotonic",
        ];
        let record = names
            .iter()
            .fold(Record::new(1).with("loss", 2.0), |record, name| {
                record.with(format!("loss_{name}"), f64::from(u8::from(*name != "jerk")))
            });
        let validation = Record::new(1)
            .with("val_loss", 3.0)
            .with("val_loss_position", 0.5);
        let panels = term_charts(&[("run", &[record, validation])]);
        let titles: Vec<&str> = panels.iter().map(Panel::title).collect();
        let expected = [
            "total",
            "diffusion",
            "position",
            "velocity_coherence",
            "accel_coherence",
            "jerk: 0 in every step",
        ];
        assert_eq!(titles, expected);
        let curve = |name: &str, value| (name.to_string(), vec![(1.0, value)]);
        assert_eq!(
            panels[0].series(),
            [curve("training", 2.0), curve("validation", 3.0)]
        );
        assert_eq!(
            panels[2].series(),
            [curve("training", 1.0), curve("validation", 0.5)]
        );
    }
}
