//! The numbers of an evaluation of listening as columns.

use kinegrad_motion::metrics::Estimate;
use serde_json::to_value;

use super::{Alignments, AtScale, Condition, Heard, Listening};
use crate::evaluation::{Column, Evaluated, Group, Number};
use crate::systems::cc_motion::evaluate::report::numbers as numbers_of;

/// The evaluation as columns, with all of it as JSON.
pub fn evaluated(listening: &Listening) -> Evaluated {
    let counts = |step: Option<u64>, seeds: Option<u64>| {
        vec![
            ("step", step),
            ("phrases", Some(listening.phrases as u64)),
            ("songs", Some(listening.songs as u64)),
            ("seeds", seeds),
        ]
    };
    let drawn = |heard: Heard| {
        let mut conditions = listening.conditions.iter();
        let found = conditions.find(|condition| condition.heard == heard);
        let mut numbers = found.map(of_condition).unwrap_or_default();
        if heard == Heard::Own && listening.tracked_beat_error.is_some() {
            let title = "beat-phase error of the network's tracker, beats";
            let error = listening.tracked_beat_error;
            add(&mut numbers, "tracked_beat_error", title, error);
        }
        numbers
    };
    let real = |heard: Heard| match heard {
        Heard::Own => of_alignments(&listening.real),
        _ => Vec::new(),
    };
    let seeds = listening.settings.seeds as u64;
    Evaluated {
        run: listening.run.clone(),
        report: "eval-listening",
        json: to_value(listening).expect("plain data"),
        drawn: Column {
            facts: counts(Some(listening.step), Some(seeds)),
            groups: groups(drawn, of_scales(&listening.guidance)),
        },
        real: Column {
            facts: counts(None, None),
            groups: groups(real, Vec::new()),
        },
        remarks: Vec::new(),
    }
}

/// A group for each condition and one for the guidance scales.
fn groups(numbers: impl Fn(Heard) -> Vec<Number>, scales: Vec<Number>) -> Vec<Group> {
    let conditions = Heard::ALL.into_iter().map(|heard| Group {
        key: heard.name(),
        title: heard.title(),
        numbers: numbers(heard),
    });
    let guidance = Group {
        key: "guidance",
        title: "GUIDANCE SCALES, OWN MUSIC",
        numbers: scales,
    };
    conditions.chain([guidance]).collect()
}

fn of_condition(condition: &Condition) -> Vec<Number> {
    let mut numbers = Vec::new();
    add(&mut numbers, "loss", "loss at high noise", condition.loss);
    for (name, title, estimate) in [
        (
            "beat_phase_error",
            "beat-phase error, beats",
            condition.beat_phase_error,
        ),
        (
            "bar_phase_error",
            "bar-phase error, bars",
            condition.bar_phase_error,
        ),
    ] {
        add(&mut numbers, name, title, estimate);
    }
    // With the own music it is the same.
    if condition.heard != Heard::Own && condition.heard_beat_phase_error.is_some() {
        for (name, title, estimate) in [
            (
                "heard_beat_phase_error",
                "beat-phase error to what was heard, beats",
                condition.heard_beat_phase_error,
            ),
            (
                "heard_bar_phase_error",
                "bar-phase error to what was heard, bars",
                condition.heard_bar_phase_error,
            ),
        ] {
            add(&mut numbers, name, title, estimate);
        }
    }
    if let Some(differences) = &condition.own_minus {
        for (name, title, estimate) in [
            ("own_minus.loss", "own minus this: loss", differences.loss),
            (
                "own_minus.beat_phase_error",
                "own minus this: beat-phase error",
                differences.beat_phase_error,
            ),
            (
                "own_minus.bar_phase_error",
                "own minus this: bar-phase error",
                differences.bar_phase_error,
            ),
        ] {
            add(&mut numbers, name, title, estimate);
        }
    }
    numbers.extend(of_alignments(&condition.alignments));
    numbers
}

fn of_alignments(alignments: &Alignments) -> Vec<Number> {
    let mut numbers = Vec::new();
    for (key, title, alignment) in [
        (
            "beat_alignment",
            "beat alignment",
            &alignments.beat_alignment,
        ),
        (
            "peak_alignment",
            "beat alignment of speed peaks",
            &alignments.peak_alignment,
        ),
    ] {
        for (name, how, estimate) in [
            ("score", "", alignment.score),
            ("chance", " by chance", alignment.chance),
            ("above_chance", " above chance", alignment.above_chance),
        ] {
            let name = format!("{key}.{name}");
            add(&mut numbers, &name, &format!("{title}{how}"), estimate);
        }
    }
    numbers
}

/// The numbers of each scale, their names and titles behind it.
fn of_scales(guidance: &[AtScale]) -> Vec<Number> {
    let of_scale = |at: &AtScale| {
        let scale = at.guidance_scale;
        let mut numbers = Vec::new();
        for (name, title, estimate) in [
            (
                "beat_phase_error",
                "beat-phase error, beats",
                at.beat_phase_error,
            ),
            (
                "bar_phase_error",
                "bar-phase error, bars",
                at.bar_phase_error,
            ),
        ] {
            add(&mut numbers, name, title, estimate);
        }
        numbers.extend(numbers_of(&at.measures));
        let named = numbers.into_iter().map(move |number| Number {
            name: format!("{scale}.{}", number.name),
            value: number.value,
            line: number
                .line
                .map(|(title, shown)| (format!("{scale}: {title}"), shown)),
        });
        named.collect::<Vec<_>>()
    };
    guidance.iter().flat_map(of_scale).collect()
}

/// A line for people, and the mean and both ends for files.
fn add(numbers: &mut Vec<Number>, name: &str, title: &str, estimate: Option<Estimate>) {
    let shown = estimate.map(|estimate| {
        let Estimate { mean, low, high } = estimate;
        format!("{mean:.4} ({low:.4} to {high:.4})")
    });
    for (end, value) in [
        ("mean", estimate.map(|estimate| estimate.mean)),
        ("low", estimate.map(|estimate| estimate.low)),
        ("high", estimate.map(|estimate| estimate.high)),
    ] {
        numbers.push(Number {
            name: format!("{name}.{end}"),
            value,
            line: (end == "mean").then(|| (title.to_owned(), shown.clone())),
        });
    }
}
