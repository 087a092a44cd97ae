//! The measures of a sampled body, compared with the training motion.

use std::collections::BTreeMap;

use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::{BodyFinding, BodyMeasure, Statistics};
use serde::{Deserialize, Serialize};

/// Most measures in a warning.
const SHOWN: usize = 3;

/// The measures of a sampled body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyRecord {
    /// Each [`BodyMeasure`] by its name.
    pub measures: BTreeMap<String, MeasureRecord>,
    /// The checks that fail, with frame and joint.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failed: Vec<String>,
    /// True if a speed or a jerk exceeds [`BodyMeasure::FAR`] times its bound.
    #[serde(default)]
    pub far: bool,
}

/// A measure of a sampled body.
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

impl BodyRecord {
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
        let failed = checks.filter(|check| !check.passed).map(|check| {
            let (name, message, allowed) = (check.name, check.message, check.threshold);
            format!("{name}: {message} (allowed {allowed})")
        });
        Self {
            measures: measures.collect(),
            failed: failed.collect(),
            far: findings.iter().any(BodyFinding::is_far),
        }
    }

    /// Speed, jerk, turns, feet and floor in a line, with the percentiles of training in brackets;
    /// `name` is that of the sample.
    pub fn line(&self, name: &str) -> String {
        use BodyMeasure::*;
        let group = |title: &str, unit: &str, digits: usize, measures: &[BodyMeasure]| {
            let found = measures.iter().filter_map(|measure| {
                let found = self.measures.get(measure.name())?;
                let bound = found.training.map(|[least, most]| match measure {
                    Lowest => format!("{least:.digits$}"),
                    _ => format!("{most:.digits$}"),
                });
                Some((format!("{:.digits$}", found.value), bound))
            });
            let (values, bounds): (Vec<String>, Vec<Option<String>>) = found.unzip();
            let known = bounds.iter().any(Option::is_some);
            let bounds = bounds.into_iter().map(|bound| bound.unwrap_or("-".into()));
            let bounds = bounds.collect::<Vec<_>>().join("/");
            let training = known.then(|| format!(" (training {bounds})"));
            let (all, training) = (values.join("/"), training.unwrap_or_default());
            (!values.is_empty()).then(|| format!("{title} {all}{unit}{training}"))
        };
        let (speeds, jerks) = (
            [MeanSpeed, Speed99, FastestJoint],
            [MeanJerk, Jerk99, LargestJerk],
        );
        let groups = [
            group("speed mean/p99/largest", " m/s", 2, &speeds),
            group("jerk mean/p99/largest", " m/s^3", 0, &jerks),
            group("turn", " degrees/s", 0, &[LargestTurn]),
            group("skating", "", 2, &[Skating]),
            group("still", "", 2, &[StillShare]),
            group("floor lowest/floating", " m", 3, &[Lowest, Floating]),
        ];
        let groups: Vec<String> = groups.into_iter().flatten().collect();
        format!("{name}: {}", groups.join("; "))
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
