//! The numbers of an evaluation as columns.

use kinegrad_motion::Value;
use serde_json::to_value;

use super::{CondSource, Evaluation, Measures, ProfileRates};
use crate::evaluation::{Column, Evaluated, Group};

/// Name in files, title, decimals and where it stands.
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
    ("mean_jerk", "mean jerk, m/s^3", 1, |m| m.mean_jerk),
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
                group("processed", "POST-PROCESSED", processed),
                group("raw", "RAW", raw),
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

fn group(key: &'static str, title: &'static str, measures: &Measures) -> Group {
    Group {
        key,
        title,
        numbers: numbers(measures),
        rows: rows(measures),
    }
}

/// Every number by its path in the JSON; a value that is not finite counts as missing.
fn numbers(measures: &Measures) -> Vec<(String, Option<f64>)> {
    let mut numbers: Vec<(String, Option<f64>)> = METRICS
        .iter()
        .map(|(key, _, _, of)| (key.to_string(), of(measures)))
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

/// The numbers for people: of checks the share that passes and the mean value.
fn rows(measures: &Measures) -> Vec<(String, Option<String>)> {
    let mut rows: Vec<(String, Option<String>)> = METRICS
        .iter()
        .map(|(_, title, decimals, of)| {
            let shown = of(measures).map(|value| format!("{value:.decimals$}"));
            (title.to_string(), shown)
        })
        .collect();
    for loss in &measures.losses {
        let shown = format!("{:.3e}", loss.value);
        rows.push((format!("loss: {}", loss.name), Some(shown)));
    }
    for (profile, rates) in PROFILES {
        let rates = rates(measures);
        rows.push((format!("{profile}: all"), Some(percent(rates.pass_rate))));
        for check in &rates.checks {
            let shown = format!("{} ({})", percent(check.pass_rate), check.value);
            rows.push((format!("{profile}: {}", check.name), Some(shown)));
        }
    }
    rows
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}
