//! The columns of an evaluation of phrases.

use kinegrad_motion::Value;
use kinegrad_motion::metrics::Estimate;
use kinegrad_train::config::SamplingConfig;
use kinegrad_train::evaluation::{Better, Group, Metrics, Number, Results, with_sampling};
use serde_json::json;

use super::beat_verdict::beat_verdict;
use super::{EvaluationReport, Measures, ProfileRates, SampleSettings};
use crate::CondSource;

/// The main measures of post-processed samples; the first one also of raw samples.
const MAIN: [(&str, Better); 6] = [
    ("strict.pass_rate", Better::Higher),
    ("beat_phase_error.mean", Better::Lower),
    ("frechet_held_out", Better::Lower),
    ("diversity", Better::NearReal),
    ("movement.path_speed.median", Better::NearReal),
    ("movement.path_jerk.median", Better::NearReal),
];

impl EvaluationReport {
    /// The results, without remarks.
    pub(super) fn results(&self, sampling: &SamplingConfig) -> Results {
        let SampleSettings { seeds, cond, .. } = self.settings;
        let mut verdict = vec![self.processed.strict.verdict(Some(&self.real.strict))];
        if cond == CondSource::Phrases {
            let error = self.processed.beat_phase_error.as_ref();
            verdict.extend(
                error.map(|error| beat_verdict(error, self.phrases, self.tracked.as_ref())),
            );
        }
        Results {
            json: with_sampling(
                json!({
                    "phrases": self.phrases,
                    "seeds": seeds,
                    "cond": cond,
                    "processed": self.processed,
                    "raw": self.raw,
                    "real": self.real,
                    "tracked_beats": self.tracked,
                }),
                sampling,
            ),
            facts: vec![
                ("phrases", [Some(self.phrases as u64); 2]),
                ("seeds", [Some(seeds as u64), None]),
            ],
            samples: Some(groups(&self.processed, &self.raw)),
            real: groups(&self.real, &self.real),
            verdict,
            remarks: Vec::new(),
        }
    }
}

/// The groups of processed and raw samples.
pub(super) fn groups(processed: &Measures, raw: &Measures) -> Vec<Group> {
    let group = |key, title, measures: &Measures, main| Group {
        key,
        title,
        numbers: Number::mark(measures.rows(), main),
    };
    vec![
        group("processed", "PROCESSED", processed, &MAIN),
        group("raw", "RAW", raw, &MAIN[..1]),
    ]
}

impl ProfileRates {
    /// The share of samples within the limits, and the check that fails most often.
    pub(super) fn verdict(&self, real: Option<&Self>) -> String {
        let lowest = self.checks.iter();
        let lowest = lowest.min_by(|a, b| a.pass_rate.total_cmp(&b.pass_rate));
        let lowest = lowest.filter(|check| check.pass_rate < 1.0);
        let worst = lowest.map(|check| {
            let failing = percent(1.0 - check.pass_rate);
            format!("; {failing} fail {}", check.name)
        });
        format!(
            "{} of the processed samples are within the limits of `strict`{}{}",
            percent(self.pass_rate),
            real.map(|real| format!(" (real: {})", percent(real.pass_rate)))
                .unwrap_or_default(),
            worst.unwrap_or_default()
        )
    }
}

impl Metrics for Measures {
    /// Every number by its path in the JSON; numbers that are not finite count as missing. Tables
    /// show a check's pass rate and mean value.
    fn rows(&self) -> Vec<Number> {
        let mut rows = Vec::new();
        let mut add = |name: &str, title: &str, decimals, value: Option<f64>| {
            let shown = value.map(|value| format!("{value:.decimals$}"));
            rows.push(Number::shown(name, value, title, shown));
        };
        let same_phrase = self.same_phrase_diversity;
        add("diversity", "diversity", 3, self.diversity);
        add(
            "same_phrase_diversity",
            "same-phrase diversity",
            3,
            same_phrase,
        );
        add(
            "frechet_held_out",
            "Fréchet to held-out",
            4,
            self.frechet_held_out,
        );
        add(
            "frechet_training",
            "Fréchet to training",
            4,
            self.frechet_training,
        );
        add("beat_alignment", "beat alignment", 3, self.beat_alignment);
        let error = self.beat_phase_error;
        let shown =
            error.map(|Estimate { mean, low, high }| format!("{mean:.3} ({low:.3} to {high:.3})"));
        add(
            "mean_jerk",
            "mean jerk by the channels, m/s^3",
            1,
            self.mean_jerk,
        );
        let name = |end: &str| format!("beat_phase_error.{end}");
        let title = "beat-phase error, beats";
        let value = error.map(|error| error.mean);
        rows.push(Number::shown(name("mean"), value, title, shown));
        rows.push(Number::in_files(name("low"), error.map(|error| error.low)));
        rows.push(Number::in_files(
            name("high"),
            error.map(|error| error.high),
        ));
        for spread in &self.movement {
            let name = |statistic| format!("movement.{}.{statistic}", spread.name);
            let both = spread.median.zip(spread.p1.zip(spread.p99));
            let shown =
                both.map(|(median, (p1, p99))| format!("{median:.3} ({p1:.3} to {p99:.3})"));
            let title = format!("{}, {}", spread.title, spread.unit);
            rows.push(Number::shown(name("median"), spread.median, title, shown));
            rows.push(Number::in_files(name("p1"), spread.p1));
            rows.push(Number::in_files(name("p99"), spread.p99));
        }
        for loss in &self.losses {
            let (name, value) = (loss.name, loss.value);
            let title = format!("loss: {name}");
            let shown = format!("{value:.3e}");
            let name = format!("loss.{name}");
            rows.push(Number::shown(name, Some(value), title, Some(shown)));
        }
        for (profile, rates) in [("ccmotion", &self.ccmotion), ("strict", &self.strict)] {
            rows.push(Number::shown(
                format!("{profile}.pass_rate"),
                Some(rates.pass_rate),
                format!("{profile}: all"),
                Some(percent(rates.pass_rate)),
            ));
            for check in &rates.checks {
                let name = |end| format!("{profile}.{}.{end}", check.name);
                rows.push(Number::shown(
                    name("pass_rate"),
                    Some(check.pass_rate),
                    format!("{profile}: {}", check.name),
                    Some(format!("{} ({})", percent(check.pass_rate), check.value)),
                ));
                let ends = match check.value {
                    Value::Number(value) => vec![("value", value)],
                    Value::Range([low, high]) => vec![("min", low), ("max", high)],
                };
                let ends = ends.into_iter();
                rows.extend(ends.map(|(end, value)| Number::in_files(name(end), Some(value))));
            }
        }
        for row in &mut rows {
            row.value = row.value.filter(|value| value.is_finite());
        }
        rows
    }
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}
