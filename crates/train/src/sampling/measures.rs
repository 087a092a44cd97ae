//! The measures of a sampled body or phrase, compared with the training motion.

use std::collections::BTreeMap;

use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::{
    BodyFinding, BodyMeasure, Check, MotionMeasure, Phrase, Profile, Statistics, check,
};
use serde::{Deserialize, Serialize};

/// Most measures in a warning.
const SHOWN: usize = 3;

/// The measures of a line, with titles and decimals.
const LINE: [(BodyMeasure, &str, usize); 9] = [
    (BodyMeasure::MeanSpeed, "mean speed", 2),
    (BodyMeasure::FastestJoint, "fastest joint", 2),
    (BodyMeasure::MeanJerk, "mean jerk", 0),
    (BodyMeasure::Jerk99, "99th percentile", 0),
    (BodyMeasure::LargestTurn, "largest turn", 0),
    (BodyMeasure::Skating, "skating", 2),
    (BodyMeasure::StillShare, "still", 2),
    (BodyMeasure::Lowest, "lowest joint", 3),
    (BodyMeasure::Floating, "floating", 3),
];

/// The measures of a sampled body or phrase.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeasuresRecord {
    /// Each [`BodyMeasure`] or, of a phrase, [`MotionMeasure`] by its name.
    pub measures: BTreeMap<String, MeasureRecord>,
    /// The checks that fail, with frame and joint of an extreme.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failed: Vec<String>,
    /// True if a speed or a jerk of a body exceeds [`BodyMeasure::FAR`] times its bound.
    #[serde(default)]
    pub far: bool,
}

/// A measure of a sampled body or phrase.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasureRecord {
    /// The value, in the measure's unit.
    pub value: f64,
    /// The frame of an extreme.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<usize>,
    /// The joint of an extreme.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// 1st and 99th percentile over the training clips, if the run knows them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training: Option<[f64; 2]>,
}

impl MeasuresRecord {
    /// Measures `joints`; `training` are the statistics of the run.
    pub fn of(joints: &Joints, skeleton: &Skeleton, training: &Statistics) -> Self {
        let description = skeleton.description();
        let (fps, names) = (description.fps, &description.joint_names);
        let findings = BodyFinding::all(joints, Some(skeleton), fps, Some(training));
        let measures = findings.iter().map(|finding| {
            let value = finding.value;
            let measure = MeasureRecord {
                value: value.value,
                frame: value.frame,
                joint: value.joint.map(|joint| names[joint].clone()),
                training: training.movement.get(finding.measure.name()).copied(),
            };
            (finding.measure.name().to_owned(), measure)
        });
        let checks = findings
            .iter()
            .filter_map(|finding| finding.check(Some(names)));
        Self {
            measures: measures.collect(),
            failed: failed(checks),
            far: findings.iter().any(BodyFinding::is_far),
        }
    }

    /// Measures a phrase; `training` are the statistics of the run.
    pub fn of_phrase(motion: &Phrase, training: &Statistics) -> Self {
        let measures = MotionMeasure::ALL.into_iter().filter_map(|measure| {
            let found = MeasureRecord {
                value: measure.of(motion)?,
                frame: None,
                joint: None,
                training: training.movement.get(measure.name()).copied(),
            };
            Some((measure.name().to_owned(), found))
        });
        Self {
            measures: measures.collect(),
            failed: failed(check(motion, Profile::Strict, Some(training)).checks),
            far: false,
        }
    }

    /// Speed, jerk, turns, feet and floor of `bodies` in a line, with the percentiles of training in
    /// brackets: means over the bodies, and of extremes the furthest. `None` without bodies.
    pub fn line(bodies: &[Self]) -> Option<String> {
        use BodyMeasure::{FastestJoint, LargestTurn, Lowest};
        let found = LINE.iter().filter_map(|(measure, title, digits)| {
            let of_each = bodies.iter();
            let of_each = of_each.filter_map(|body| body.measures.get(measure.name()));
            let values = of_each.clone().map(|found| found.value);
            let count = values.clone().count() as f64;
            let value = match measure {
                Lowest => values.reduce(f64::min),
                FastestJoint | LargestTurn => values.reduce(f64::max),
                _ => values
                    .reduce(|sum, value| sum + value)
                    .map(|sum| sum / count),
            }?;
            let training = of_each.clone().find_map(|found| found.training);
            let training = training.map(|[least, most]| {
                let bound = if *measure == Lowest { least } else { most };
                format!(" (training {bound:.digits$})")
            });
            let (unit, training) = (measure.unit(), training.unwrap_or_default());
            let value = format!("{title} {value:.digits$} {unit}");
            Some(format!("{}{training}", value.trim_end()))
        });
        let found: Vec<String> = found.collect();
        (!found.is_empty()).then(|| found.join("; "))
    }

    /// The warning about a body out of bounds; `name` is that of its sample.
    pub fn warning(&self, name: &str) -> Option<String> {
        let shown = &self.failed[..self.failed.len().min(SHOWN)];
        let more = match self.failed.len() - shown.len() {
            0 => String::new(),
            more => format!("; and {more} more"),
        };
        let verdict = match self.far {
            true => ": this motion is not usable",
            false => "",
        };
        let list = shown.join("; ");
        (!shown.is_empty()).then(|| format!("{name} is out of bounds: {list}{more}{verdict}"))
    }
}

/// Name, measurement and allowed values of the checks that fail.
fn failed(checks: impl IntoIterator<Item = Check>) -> Vec<String> {
    let failed = checks.into_iter().filter(|check| !check.passed);
    let failed = failed.map(|check| {
        let (name, message, allowed) = (check.name, check.message, check.threshold);
        format!("{name}: {message} (allowed {allowed})")
    });
    failed.collect()
}
