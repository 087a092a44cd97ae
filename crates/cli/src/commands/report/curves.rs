//! The curves of a training.

use kinegrad_report::{Panel, Series};
use kinegrad_train::telemetry::Record;

/// Numbers of the clock.
const CLOCK: [&str; 2] = ["time", "elapsed_seconds"];

/// How fast it goes.
const SPEED: &str = "steps_per_second";

/// What comes first, in this order.
const ORDER: [&str; 5] = ["loss", "val_loss", "lr", "grad_norm", SPEED];

/// Everything that was measured over steps, what belongs together in one chart. Terms are shown
/// where there are several: one alone is the loss.
pub fn charts(records: &[Record]) -> Vec<Panel> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in records.iter().flat_map(|record| record.scalars()) {
        if !names.contains(&name.as_str()) && !CLOCK.contains(&name.as_str()) {
            names.push(name);
        }
    }
    // A validation counts the steps of the same time again, that at the start none.
    let counts = |record: &Record, name: &str| name != SPEED || record.get("loss").is_some();
    let line = |name: &str, shown: &str| -> Series {
        let records = records.iter().filter(|record| counts(record, name));
        let points = records.filter_map(|record| Some((record.step as f64, record.get(name)?)));
        (shown.to_string(), points.collect())
    };
    let chart = |title: &str, lines: Vec<Series>| Panel::lines(title, "step", lines);
    let mut taken = Vec::new();
    let mut charts = Vec::new();
    // Each in its own colour and at its own place, whichever was measured first.
    let order = |name: &&str| {
        let place = ORDER.iter().position(|known| known == name);
        place.unwrap_or(ORDER.len())
    };
    names.sort_by_key(order);
    let loss: Vec<&str> = names
        .iter()
        .copied()
        .filter(|name| ["loss", "val_loss"].contains(name))
        .collect();
    charts.push(chart(
        "loss",
        loss.iter().map(|name| line(name, name)).collect(),
    ));
    taken.extend(loss);
    for (title, prefix) in [
        ("terms of the loss", "loss_"),
        ("terms of the validation loss", "val_loss_"),
        ("learning rates", "lr_"),
    ] {
        let terms: Vec<&str> = names
            .iter()
            .copied()
            .filter(|name| name.starts_with(prefix))
            .collect();
        if terms.len() > 1 {
            let lines = terms.iter().map(|name| line(name, &name[prefix.len()..]));
            charts.push(chart(title, lines.collect()));
        }
        taken.extend(terms);
    }
    let titles = [
        ("lr", "learning rate"),
        ("grad_norm", "gradient norm"),
        (SPEED, "steps per second"),
    ];
    for name in names.iter().filter(|name| !taken.contains(name)) {
        let title = titles.iter().find(|(known, _)| known == name);
        let title = title.map_or(*name, |(_, title)| title);
        charts.push(chart(title, vec![line(name, name)]));
    }
    charts.retain(|chart| !chart.is_empty());
    charts
}

/// Seconds of training: each process counts its own from the step on that it went on from.
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
    fn what_belongs_together_is_one_chart() {
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
        let charts = charts(&[record, validation]);
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
    fn a_validation_before_the_first_step_changes_neither_order_nor_speed() {
        let validation = |step| {
            let record = Record::new(step).with("val_loss", 2.5);
            record.with("steps_per_second", 0.0)
        };
        let step = Record::new(1)
            .with("loss", 2.0)
            .with("steps_per_second", 3.0);
        let charts = charts(&[validation(0), step.with("grad_norm", 1.0), validation(1)]);
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
