//! The curves of a training run.

use std::collections::HashSet;

use kinegrad_report::Panel;
use kinegrad_train::telemetry::Record;

/// Most scalars that are shown.
const MOST_NAMES: usize = 200;

/// Scalars that measure time.
const CLOCK: [&str; 2] = ["time", "elapsed_seconds"];

/// Scalar of the speed.
const SPEED: &str = "steps_per_second";

/// Order of the first scalars.
const ORDER: [&str; 5] = ["loss", "val_loss", "lr", "grad_norm", SPEED];

/// Titles and prefixes of scalars that are parts of another one. A single part equals the whole.
const PARTS: [(&str, &str); 3] = [
    ("terms of the loss", "loss_"),
    ("terms of the validation loss", "val_loss_"),
    ("learning rates", "lr_"),
];

/// The metrics of a run, by its name.
pub type Metrics<'a> = (&'a str, &'a [Record]);

/// All scalars of runs over steps. Of one run, related scalars share a chart, and the terms of a loss
/// are shown if there are several. Of several runs, each scalar has a chart with a curve per run.
pub fn charts(runs: &[Metrics<'_>]) -> Vec<Panel> {
    let (mut names, mut known) = (Vec::new(), HashSet::new());
    let records = runs.iter().flat_map(|(_, records)| *records);
    for (name, _) in records.flat_map(|record| &record.scalars) {
        if !CLOCK.contains(&name.as_str()) && known.insert(name.as_str()) {
            names.push(name.as_str());
        }
    }
    // Colors and places do not depend on the first record.
    let place = |name: &&str| ORDER.iter().position(|known| known == name);
    names.sort_by_key(|name| place(name).unwrap_or(ORDER.len()));
    if names.len() > MOST_NAMES {
        tell!("note: {MOST_NAMES} of {} metrics are shown", names.len());
        names.truncate(MOST_NAMES);
    }
    let chart = |title: &str, names: &[&str], prefix: &str| {
        let lines = runs.iter().flat_map(|(run, records)| {
            names.iter().map(|name| match runs.len() {
                1 => (name[prefix.len()..].to_string(), points(records, name)),
                _ => (run.to_string(), points(records, name)),
            })
        });
        Panel::lines(title, "step", lines.collect())
    };
    let mut charts = Vec::new();
    let mut take = |title: &str, prefix: &str, least: usize, is_one: &dyn Fn(&str) -> bool| {
        let (taken, rest): (Vec<&str>, Vec<&str>) =
            names.iter().copied().partition(|name| is_one(name));
        if taken.len() >= least {
            charts.push(chart(title, &taken, prefix));
        }
        names = rest;
    };
    if runs.len() == 1 {
        take("loss", "", 0, &|name| ["loss", "val_loss"].contains(&name));
        for (title, prefix) in PARTS {
            take(title, prefix, 2, &|name| name.starts_with(prefix));
        }
    } else {
        for (_, prefix) in PARTS {
            let is_part = |name: &&str| name.starts_with(prefix);
            if names.iter().filter(|name| is_part(name)).count() == 1 {
                names.retain(|name| !is_part(name));
            }
        }
    }
    let titles = [
        ("val_loss", "validation loss"),
        ("lr", "learning rate"),
        ("grad_norm", "gradient norm"),
        (SPEED, "steps per second"),
    ];
    for name in names {
        let title = titles.iter().find(|(known, _)| *known == name);
        charts.push(chart(title.map_or(name, |(_, title)| title), &[name], ""));
    }
    charts.retain(|chart| !chart.is_empty());
    charts
}

/// The curve of a scalar over steps.
fn points(records: &[Record], name: &str) -> Vec<(f64, f64)> {
    // Records of validations have another speed than training.
    let counts = |record: &&Record| name != SPEED || record.get("loss").is_some();
    let measured = records.iter().filter(counts);
    let points = measured.filter_map(|record| Some((record.step as f64, record.get(name)?)));
    points.collect()
}

/// Seconds of training, summed over starts; the records of each start count from zero.
pub fn training_seconds(records: &[Record]) -> f64 {
    let mut total = 0.0;
    let mut before: f64 = 0.0;
    for elapsed in records.iter().filter_map(|r| r.get("elapsed_seconds")) {
        if elapsed < before {
            total += before;
        }
        before = elapsed;
    }
    total + before
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn related_scalars_share_a_chart() {
        let record = Record::new(1)
            .with("loss", 2.0)
            .with("lr", 0.1)
            .with("lr_unet", 0.1)
            .with("lr_decoder", 0.2)
            .with("loss_position", 1.0)
            .with("loss_velocity", 1.0)
            .with("mine", 3.0)
            .with("time", 9.0);
        let validation = Record::new(1)
            .with("val_loss", 2.5)
            .with("val_loss_position", 2.5);
        let charts = charts(&[("run", &[record, validation])]);
        let shown: Vec<_> = charts
            .iter()
            .map(|chart| {
                let names = chart.series().iter().map(|(name, _)| name.as_str());
                (chart.title(), names.collect::<Vec<_>>())
            })
            .collect();
        let expected = [
            ("loss", vec!["loss", "val_loss"]),
            ("terms of the loss", vec!["position", "velocity"]),
            ("learning rates", vec!["unet", "decoder"]),
            ("learning rate", vec!["lr"]),
            ("mine", vec!["mine"]),
        ];
        assert_eq!(shown, expected);
    }

    #[test]
    fn of_very_many_scalars_the_first_are_shown() {
        let named = |record: Record, index| record.with(format!("mine {index}"), 1.0);
        let record = (0..1000).fold(Record::new(1), named).with("loss", 2.0);
        let titles = charts(&[("run", &[record])]);
        let titles: Vec<&str> = titles.iter().map(Panel::title).collect();
        assert_eq!(titles.len(), MOST_NAMES);
        assert_eq!(titles[..2], ["loss", "mine 0"]);
    }

    #[test]
    fn runs_share_the_chart_of_each_scalar() {
        let record = |loss| {
            Record::new(1)
                .with("loss", loss)
                .with("loss_position", loss)
        };
        let [one, two] = [[record(2.0)], [record(1.0).with("lr", 0.1)]];
        let charts = charts(&[("one", &one), ("two", &two)]);
        let titles: Vec<&str> = charts.iter().map(Panel::title).collect();
        // A single term is the loss itself.
        assert_eq!(titles, ["loss", "learning rate"]);
        let curve = |name: &str, points: &[(f64, f64)]| (name.to_string(), points.to_vec());
        let expected = [curve("one", &[(1.0, 2.0)]), curve("two", &[(1.0, 1.0)])];
        assert_eq!(charts[0].series(), expected);
        // A run without a scalar keeps its place, and the others their colors.
        let expected = [curve("one", &[]), curve("two", &[(1.0, 0.1)])];
        assert_eq!(charts[1].series(), expected);
    }

    #[test]
    fn a_validation_before_the_first_step_changes_neither_order_nor_speed() {
        let validation = |step| {
            let record = Record::new(step).with("val_loss", 2.5);
            record.with("steps_per_second", 0.0)
        };
        let step = Record::new(1)
            .with("loss", 2.0)
            .with("steps_per_second", 3.0);
        let records = [validation(0), step.with("grad_norm", 1.0), validation(1)];
        let charts = charts(&[("run", &records)]);
        let titles: Vec<&str> = charts.iter().map(Panel::title).collect();
        assert_eq!(titles, ["loss", "gradient norm", "steps per second"]);
        assert_eq!(charts[0].series()[0].0, "loss");
        assert_eq!(charts[2].series()[0].1, [(1.0, 3.0)]);
    }

    #[test]
    fn the_time_of_all_processes_counts() {
        let records = [1.0, 5.0, 0.5, 2.0, 1.0].map(|t| Record::new(1).with("elapsed_seconds", t));
        assert_eq!(training_seconds(&records), 8.0);
        assert_eq!(training_seconds(&[]), 0.0);
    }
}
