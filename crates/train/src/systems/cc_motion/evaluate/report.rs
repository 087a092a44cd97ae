//! The numbers of an evaluation as columns.

use kinegrad_motion::Value;
use serde_json::to_value;

use super::{CondSource, Evaluation, Measures, ProfileRates};
use crate::evaluation::{Column, Evaluated, Group, Number};

/// Name in files and in tables, decimals in tables.
type Metric = (
    &'static str,
    &'static str,
    usize,
    fn(&Measures) -> Option<f64>,
);

const METRICS: [Metric; 6] = [
    ("diversity", "diversity", 3, |m| m.diversity),
    ("same_phrase_diversity", "same-phrase diversity", 3, |m| {
        m.same_phrase_diversity
    }),
    ("frechet_held_out", "Fréchet to held-out", 4, |m| {
        m.frechet_held_out
    }),
    ("frechet_training", "Fréchet to training", 4, |m| {
        m.frechet_training
    }),
    ("beat_alignment", "beat alignment", 3, |m| m.beat_alignment),
    ("mean_jerk", "mean jerk by the channels, m/s^3", 1, |m| {
        m.mean_jerk
    }),
];

type Rates = fn(&Measures) -> &ProfileRates;

const PROFILES: [(&str, Rates); 2] = [
    ("document", |measures| &measures.document),
    ("strict", |measures| &measures.strict),
];

/// The evaluation as columns, with all of it as JSON.
pub fn evaluated(evaluation: &Evaluation) -> Evaluated {
    let column = |counts: [Option<u64>; 3], processed: &Measures, raw: &Measures| {
        let [step, phrases, seeds] = counts;
        Column {
            facts: vec![("step", step), ("phrases", phrases), ("seeds", seeds)],
            groups: vec![
                Group {
                    key: "processed",
                    title: "POST-PROCESSED",
                    numbers: numbers(processed),
                },
                Group {
                    key: "raw",
                    title: "RAW",
                    numbers: numbers(raw),
                },
            ],
        }
    };
    let phrases = Some(evaluation.phrases as u64);
    let seeds = Some(evaluation.settings.seeds as u64);
    Evaluated {
        run: evaluation.run.clone(),
        report: match evaluation.settings.cond {
            CondSource::Phrases => "eval",
            CondSource::Noise => "eval-noise",
        },
        json: to_value(evaluation).expect("plain data"),
        drawn: column(
            [Some(evaluation.step), phrases, seeds],
            &evaluation.processed,
            &evaluation.raw,
        ),
        real: column([None, phrases, None], &evaluation.real, &evaluation.real),
        remarks: Vec::new(),
    }
}

/// Every number by its path in the JSON; one that is not finite counts as missing. People see of
/// checks the share that passes and the mean value.
pub(super) fn numbers(measures: &Measures) -> Vec<Number> {
    let mut numbers = Vec::new();
    let mut add = |name: String, value: Option<f64>, line| {
        let value = value.filter(|value| value.is_finite());
        numbers.push(Number { name, value, line });
    };
    let line = |title: String, shown: String| Some((title, Some(shown)));
    for (key, title, decimals, of) in METRICS {
        let value = of(measures);
        let shown = value.map(|value| format!("{value:.decimals$}"));
        add(key.to_string(), value, Some((title.to_string(), shown)));
    }
    for spread in &measures.movement {
        let name = |what| format!("movement.{}.{what}", spread.name);
        let shown = match (spread.median, spread.p1, spread.p99) {
            (Some(median), Some(p1), Some(p99)) => {
                Some(format!("{median:.3} ({p1:.3} to {p99:.3})"))
            }
            _ => None,
        };
        let title = format!("movement: {}, {}", spread.title, spread.unit);
        add(name("median"), spread.median, Some((title, shown)));
        add(name("p1"), spread.p1, None);
        add(name("p99"), spread.p99, None);
    }
    for loss in &measures.losses {
        let shown = line(
            format!("loss: {}", loss.name),
            format!("{:.3e}", loss.value),
        );
        add(format!("loss.{}", loss.name), Some(loss.value), shown);
    }
    for (profile, rates) in PROFILES {
        let rates = rates(measures);
        let shown = line(format!("{profile}: all"), percent(rates.pass_rate));
        add(format!("{profile}.pass_rate"), Some(rates.pass_rate), shown);
        for check in &rates.checks {
            let name = format!("{profile}.{}", check.name);
            let shown = format!("{} ({})", percent(check.pass_rate), check.value);
            let shown = line(format!("{profile}: {}", check.name), shown);
            add(format!("{name}.pass_rate"), Some(check.pass_rate), shown);
            match check.value {
                Value::Number(value) => add(format!("{name}.value"), Some(value), None),
                Value::Range([low, high]) => {
                    add(format!("{name}.min"), Some(low), None);
                    add(format!("{name}.max"), Some(high), None);
                }
            }
        }
    }
    numbers
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}
