//! A new motion beside its examples: the bounds of its measures.

use kinegrad_motion::BodyMeasure;
use serde::Serialize;

use super::movement::Movement;

/// Largest ratios to the examples.
const TOE: f64 = 1.3;
const JERK: f64 = 1.5;
pub(super) const FASTEST: f64 = 1.5;
const TURN: f64 = 2.0;
/// Largest excess of the share of still frames.
const STILLER: f64 = 0.05;
/// Smallest mean speed and speed of the fastest joint, as parts of the examples'.
const SLOWEST: f64 = 0.6;
const SLOWEST_JOINT: f64 = 0.3;
/// Toe speed in body heights a second, and degrees of a turn, that are always allowed.
const HARMLESS_TOE: f64 = 0.005;
const HARMLESS_TURN: f64 = 10.0;
/// Speed of the fastest joint in body heights a second, and jerk in body heights a second cubed, of
/// lively people: the least bounds for unusable motion, because examples may stand still or be
/// smoothed.
pub(super) const LIVELY_SPEED: f64 = 2.0;
const LIVELY_JERK: f64 = 200.0;

/// A motion beside its examples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// The new motion.
    pub motion: Movement,
    /// The examples: means over all their frames and the largest of all.
    pub examples: Movement,
    /// Height of the body, in their units.
    #[serde(skip)]
    pub(super) height: f64,
    /// The largest jerk and fastest joint of the examples and of the motions that parts and contents
    /// are taken from.
    #[serde(skip)]
    pub(super) liveliest: Liveliest,
}

/// The measures by which a motion is unusable.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Liveliest {
    pub jerk: f64,
    pub fastest_joint: f64,
}

/// A measure, its name, the bound that it must not exceed, and a description of where it is largest.
struct Bounded {
    name: &'static str,
    value: f64,
    example: f64,
    bound: f64,
    /// Bound beyond which the motion is not usable.
    far: f64,
    at: String,
}

impl Quality {
    /// The measures in metres, of motions in units of so many metres.
    #[must_use]
    pub fn in_metres(self, metres_per_unit: f64) -> Self {
        Self {
            motion: self.motion.scaled(metres_per_unit),
            examples: self.examples.scaled(metres_per_unit),
            height: metres_per_unit * self.height,
            liveliest: Liveliest {
                jerk: metres_per_unit * self.liveliest.jerk,
                fastest_joint: metres_per_unit * self.liveliest.fastest_joint,
            },
        }
    }

    /// The measures that a motion must not exceed. `harmless`: toe speed that is always allowed, in
    /// body heights a second.
    fn bounded(&self, harmless: f64) -> Vec<Bounded> {
        let (motion, examples) = (&self.motion, &self.examples);
        let bounded = |name, value, example, bound, at| Bounded {
            name,
            value,
            example,
            bound,
            far: f64::INFINITY,
            at,
        };
        let far = |bound: f64, lively: f64| BodyMeasure::FAR * bound.max(lively * self.height);
        let mut all = Vec::new();
        if let (Some(toe), Some(example)) =
            (motion.toe_speed_while_low, examples.toe_speed_while_low)
        {
            let bound = (TOE * example).max(harmless * self.height);
            let name = "toe speed while low";
            all.push(bounded(name, toe, example, bound, String::new()));
        }
        let (jerk, fastest) = (examples.jerk, examples.fastest_joint);
        let place = |(frame, joint): &(usize, String)| format!(" ({joint}, frame {frame})");
        let jerk_at = match motion.jerk_at.1.is_empty() {
            true => String::new(),
            false => place(&motion.jerk_at),
        };
        let turn = (TURN * examples.largest_turn).max(HARMLESS_TURN);
        let turned = format!(" (frame {})", motion.turn_at);
        let still = examples.still_share;
        all.extend([
            Bounded {
                far: far(JERK * self.liveliest.jerk, LIVELY_JERK),
                ..bounded("jerk", motion.jerk, jerk, JERK * jerk, jerk_at)
            },
            Bounded {
                far: far(FASTEST * self.liveliest.fastest_joint, LIVELY_SPEED),
                ..bounded(
                    "fastest joint",
                    motion.fastest_joint,
                    fastest,
                    FASTEST * fastest,
                    place(&motion.fastest_at),
                )
            },
            bounded(
                "largest turn",
                motion.largest_turn,
                examples.largest_turn,
                turn,
                turned,
            ),
            bounded(
                "still share",
                motion.still_share,
                still,
                still + STILLER,
                String::new(),
            ),
        ]);
        all
    }

    /// The speeds that a motion must reach, each with its name and bound.
    fn least_speeds(&self) -> [(&'static str, f64, f64); 2] {
        let (motion, examples) = (&self.motion, &self.examples);
        let mean = SLOWEST * examples.mean_speed;
        let fastest = SLOWEST_JOINT * examples.fastest_joint;
        [
            ("mean speed", motion.mean_speed, mean),
            ("fastest joint", motion.fastest_joint, fastest),
        ]
    }

    /// The largest measure relative to its bound: at most 1 for a motion within all bounds. Speeds
    /// below their bounds count squared, because a motion that slides is better than one that
    /// freezes.
    pub fn excess(&self) -> f64 {
        self.excess_beside(HARMLESS_TOE)
    }

    /// [`Self::excess`] if no toe speed above the examples' is harmless.
    pub(crate) fn strict_excess(&self) -> f64 {
        self.excess_beside(0.0)
    }

    fn excess_beside(&self, harmless: f64) -> f64 {
        let tiny = 1e-9 * self.height.max(f64::MIN_POSITIVE);
        let of = |each: Bounded| each.value / each.bound.max(tiny);
        let bounded = self.bounded(harmless).into_iter();
        let excess = bounded.map(of).fold(0.0, f64::max);
        let slower = |(_, speed, least): (_, f64, f64)| (least / speed.max(tiny)).powi(2);
        self.least_speeds()
            .map(slower)
            .into_iter()
            .fold(excess, f64::max)
    }

    /// True if the motion is not usable: its jerk or its fastest joint exceeds [`BodyMeasure::FAR`]
    /// times the bound, that of the liveliest source or of lively people.
    pub fn is_far(&self) -> bool {
        let mut bounded = self.bounded(HARMLESS_TOE).into_iter();
        bounded.any(|each| each.value > each.far)
    }

    /// The measures beyond their bounds, each with its value, that of the examples, the bound, and
    /// frame and joint.
    pub fn beyond(&self) -> Vec<String> {
        let bounded = self.bounded(HARMLESS_TOE).into_iter();
        let beyond = bounded.filter(|each| each.value > each.bound);
        let text = |each: Bounded| {
            let verdict = match each.value > each.far {
                true => ": this motion is not usable",
                false => "",
            };
            format!(
                "{} {:.3}{}, examples {:.3}, bound {:.3}{verdict}",
                each.name, each.value, each.at, each.example, each.bound
            )
        };
        let mut all: Vec<String> = beyond.map(text).collect();
        let slow = self.least_speeds().into_iter();
        let slow = slow.filter(|(_, speed, least)| speed < least);
        all.extend(slow.map(|(name, speed, least)| {
            format!("{name} {speed:.3}, at least {least:.3} expected")
        }));
        all
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A bow beside a motion of it, in metres: toe speed, jerk, fastest joint and mean speed.
    fn beside_a_bow([toe, jerk, fastest_joint, mean_speed]: [f64; 4]) -> Quality {
        let examples = Movement {
            toe_speed_while_low: Some(0.001),
            jerk: 14.7,
            fastest_joint: 1.24,
            largest_turn: 1.4,
            mean_speed: 0.073,
            ..Movement::default()
        };
        let motion = Movement {
            toe_speed_while_low: Some(toe),
            jerk,
            fastest_joint,
            mean_speed,
            ..examples.clone()
        };
        Quality {
            motion,
            liveliest: Liveliest {
                jerk: examples.jerk,
                fastest_joint: examples.fastest_joint,
            },
            examples,
            height: 1.37,
        }
    }

    #[test]
    fn a_frozen_gesture_is_worse_than_one_that_slides_or_shakes() {
        let harmless = beside_a_bow([0.006, 14.7, 1.24, 0.073]);
        assert!(harmless.excess() <= 1.0, "{}", harmless.excess());
        let frozen = beside_a_bow([0.006, 14.7, 0.05, 0.017]);
        let frozen_in_most_joints = beside_a_bow([0.006, 14.7, 0.05, 0.05]);
        let shaking = beside_a_bow([0.017, 65.0, 1.69, 0.088]);
        for frozen in [frozen, frozen_in_most_joints] {
            let (better, worse) = (shaking.excess(), frozen.excess());
            assert!(2.0 * better < worse, "{better} {worse}");
            let warnings = frozen.beyond().join("\n");
            assert!(
                warnings.contains("fastest joint 0.050, at least 0.372"),
                "{warnings}"
            );
        }
    }

    #[test]
    fn examples_that_hardly_move_are_no_measure_of_usable_motion() {
        let livelier = |factor: f64| beside_a_bow([0.001, factor * 14.7, factor * 1.24, 0.073]);
        assert!(!livelier(4.0).is_far());
        assert!(livelier(60.0).is_far());
    }

    proptest! {
        #[test]
        fn motions_beyond_a_bound_have_a_warning(
            toe in 0.0..0.02f64, jerk in 10.0..30.0f64, fastest in 0.2..2.0f64, mean in 0.03..0.1f64,
        ) {
            let quality = beside_a_bow([toe, jerk, fastest, mean]);
            prop_assert_eq!(quality.excess() > 1.0, !quality.beyond().is_empty());
        }
    }
}
