//! Measures of a body beside those of reference motion.

use super::{Check, Threshold, Value, people};
use crate::humanml::{Joints, Skeleton};
use crate::{BodyMeasure, BodyValue, Statistics};

/// A measure of a body, and its values in reference motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyFinding {
    /// The measure.
    pub measure: BodyMeasure,
    /// Its value.
    pub value: BodyValue,
    /// 1st and 99th percentile of the training clips, or of captured people; `None` where neither
    /// is known.
    pub reference: Option<[f64; 2]>,
}

impl BodyFinding {
    /// All measures of `joints` at `fps` frames per second that exist. References are those of
    /// `statistics`, or of captured people for measures that the statistics lack.
    pub fn all(
        joints: &Joints,
        skeleton: Option<&Skeleton>,
        fps: f64,
        statistics: Option<&Statistics>,
    ) -> Vec<Self> {
        let people = people::bodies();
        let of = |measure: BodyMeasure| {
            let known = statistics.and_then(|training| training.movement.get(measure.name()));
            Some(Self {
                measure,
                value: measure.of(joints, skeleton, fps)?,
                reference: known.or_else(|| people.get(measure.name())).copied(),
            })
        };
        BodyMeasure::ALL.into_iter().filter_map(of).collect()
    }

    /// The allowed values; `None` for unchecked measures.
    pub fn threshold(&self) -> Option<Threshold> {
        self.measure.bounds().threshold(self.reference?, 1.0)
    }

    /// The check, whose message names frame and joint of an extreme; `None` for unchecked measures.
    pub fn check(&self, joint_names: Option<&[String]>) -> Option<Check> {
        let (name, value) = (self.measure.name(), self.value.value);
        Some(Check::new(
            name,
            value,
            self.threshold()?,
            self.message(joint_names),
        ))
    }

    /// True for a speed or a jerk beyond [`BodyMeasure::FAR`] times its bound.
    pub fn is_far(&self) -> bool {
        let value = Value::Number(self.value.value / BodyMeasure::FAR);
        let admits = |threshold: Threshold| threshold.admits(value);
        self.measure.is_of_speed() && !self.threshold().is_none_or(admits)
    }

    /// The measurement in words.
    fn message(&self, joint_names: Option<&[String]>) -> String {
        let (measure, value) = (self.measure, self.value);
        let message = format!("{} {:.3} {}", measure.title(), value.value, measure.unit());
        let mut message = message.trim_end().to_owned();
        if let Some(frame) = value.frame {
            message += &format!(" in frame {frame}");
        }
        if let (Some(joint), Some(names)) = (value.joint, joint_names) {
            message += &format!(", joint {}", names[joint]);
        }
        message
    }
}
