//! Measures of a phrase's movement, from positions, quaternions and phase.
//!
//! The derivative channels are not used, because they are inaccurate in generated phrases. Checked
//! measures are means or extremes over frames, so phrases of different lengths are comparable.

use crate::derivatives::{angular_rates, differences, mean_norm};
use crate::phrase::{PHASE, POSITION};
use crate::quantiles::median;
use crate::sanity::{Bounds, FACTOR, Margin};
use crate::vector::length;
use crate::{FPS, Phrase, Quaternion, circular};

/// Frames in a second.
const SECOND: usize = FPS as usize;

/// [`FACTOR`] of the phase: tempi vary less than dancers, and half the slowest tempo is an error.
const PHASE_FACTOR: f64 = 1.5;

/// Allowed distance of heights beyond the training phrases.
const HEIGHT_MARGIN: Margin = Margin {
    share: 0.15,
    least: 0.05,
};

/// The same of the lowest height: a dancer may dip deeper than any of the training phrases.
const DIP_MARGIN: Margin = Margin {
    share: 0.25,
    least: 0.05,
};

/// Tilt in degrees that is always allowed.
const HARMLESS_TILT: f64 = 20.0;

/// Acceleration that is always allowed, metres per second squared.
const HARMLESS_ACCELERATION: f64 = 30.0;

/// A root slower than this, metres per second, is still if it does not turn either.
const STILL_SPEED: f64 = 0.02;

/// Turn rate below which a root is still, degrees per second.
const STILL_TURN: f64 = 2.0;

/// Allowed share of still steps beyond the training phrases.
const STILL_MARGIN: Margin = Margin {
    share: 0.0,
    least: 0.3,
};

/// A measure of how a phrase moves.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum MotionMeasure {
    /// Mean speed of the root along its path, metres per second.
    PathSpeed,
    /// Largest speed of the root from one frame to the next, metres per second.
    FastestStep,
    /// Mean norm of the second difference of the positions, metres per second squared.
    PathAcceleration,
    /// Mean norm of the third difference of the positions, metres per second cubed.
    PathJerk,
    /// Mean distance on the floor between positions one second apart, metres.
    Travel,
    /// Median height of the root, metres.
    Height,
    /// Lowest height of the root, metres.
    LowestHeight,
    /// Highest height of the root, metres.
    HighestHeight,
    /// Mean angle between the orientations of neighbouring frames, degrees per second.
    TurnRate,
    /// Mean norm of the change of the angular velocity, degrees per second squared.
    TurnAcceleration,
    /// Largest angle between the orientations of neighboring frames, degrees.
    LargestTurn,
    /// Largest angle between the body's own upward axis, its local +y, and the vertical, degrees.
    LargestTilt,
    /// Mean advance of the phase, by shortest steps, bars per second.
    PhaseRate,
    /// Largest shortest step of the phase between frames, bars.
    LargestPhaseStep,
    /// Largest acceleration of the root, metres per second squared: that of a jump is large.
    LargestAcceleration,
    /// Share of the steps between frames in which the root neither moves nor turns.
    StillShare,
    /// Distance on the floor between the first and the last position, metres.
    NetTravel,
    /// Number of bar lines that the phase passes, minus those that it passes backwards.
    PhaseWraps,
}

impl MotionMeasure {
    /// All measures.
    pub const ALL: [Self; 18] = [
        Self::PathSpeed,
        Self::FastestStep,
        Self::PathAcceleration,
        Self::PathJerk,
        Self::Travel,
        Self::Height,
        Self::LowestHeight,
        Self::HighestHeight,
        Self::TurnRate,
        Self::TurnAcceleration,
        Self::LargestTurn,
        Self::LargestTilt,
        Self::PhaseRate,
        Self::LargestPhaseStep,
        Self::LargestAcceleration,
        Self::StillShare,
        Self::NetTravel,
        Self::PhaseWraps,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::PathSpeed => "path_speed",
            Self::FastestStep => "fastest_step",
            Self::PathAcceleration => "path_acceleration",
            Self::PathJerk => "path_jerk",
            Self::Travel => "travel",
            Self::Height => "height",
            Self::LowestHeight => "lowest_height",
            Self::HighestHeight => "highest_height",
            Self::TurnRate => "turn_rate",
            Self::TurnAcceleration => "turn_acceleration",
            Self::LargestTurn => "largest_turn",
            Self::LargestTilt => "largest_tilt",
            Self::PhaseRate => "phase_rate",
            Self::LargestPhaseStep => "largest_phase_step",
            Self::LargestAcceleration => "largest_acceleration",
            Self::StillShare => "still_share",
            Self::NetTravel => "net_travel",
            Self::PhaseWraps => "phase_wraps",
        }
    }

    /// Its description, for messages.
    pub fn title(self) -> &'static str {
        match self {
            Self::PathSpeed => "mean speed along the path",
            Self::FastestStep => "largest speed of the root",
            Self::PathAcceleration => "mean acceleration of the path",
            Self::PathJerk => "mean jerk of the path",
            Self::Travel => "mean travel in a second",
            Self::Height => "median height of the root",
            Self::LowestHeight => "lowest height of the root",
            Self::HighestHeight => "highest height of the root",
            Self::TurnRate => "mean turn rate",
            Self::TurnAcceleration => "mean change of the turn rate",
            Self::LargestTurn => "largest turn from one frame to the next",
            Self::LargestTilt => "largest tilt from the vertical",
            Self::PhaseRate => "mean advance of the phase",
            Self::LargestPhaseStep => "largest step of the phase from one frame to the next",
            Self::LargestAcceleration => "largest acceleration of the root",
            Self::StillShare => "share of the steps without movement",
            Self::NetTravel => "travel from the first frame to the last",
            Self::PhaseWraps => "wraps of the phase",
        }
    }

    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::PathSpeed | Self::FastestStep => "m/s",
            Self::PathAcceleration | Self::LargestAcceleration => "m/s^2",
            Self::PathJerk => "m/s^3",
            Self::Travel
            | Self::Height
            | Self::LowestHeight
            | Self::HighestHeight
            | Self::NetTravel => "m",
            Self::TurnRate => "degrees/s",
            Self::TurnAcceleration => "degrees/s^2",
            Self::LargestTurn | Self::LargestTilt => "degrees",
            Self::PhaseRate => "bars/s",
            Self::LargestPhaseStep => "bars",
            Self::PhaseWraps => "bars",
            Self::StillShare => "",
        }
    }

    /// The checked sides and the factor.
    pub fn bounds(self) -> Bounds {
        match self {
            // Low values (even turning, even counting, standing) are plausible.
            Self::FastestStep | Self::LargestTurn | Self::LargestPhaseStep | Self::Travel => {
                Bounds::Upper(FACTOR)
            }
            Self::LargestTilt => Bounds::UpperBeyond {
                factor: FACTOR,
                harmless: HARMLESS_TILT,
                end: 180.0,
            },
            Self::LargestAcceleration => Bounds::UpperBeyond {
                factor: FACTOR,
                harmless: HARMLESS_ACCELERATION,
                end: f64::INFINITY,
            },
            Self::StillShare => Bounds::NotAbove(STILL_MARGIN),
            Self::PhaseRate => Bounds::Both(PHASE_FACTOR),
            Self::Height => Bounds::Around(HEIGHT_MARGIN),
            Self::LowestHeight => Bounds::NotBelow(DIP_MARGIN),
            Self::HighestHeight => Bounds::NotAbove(HEIGHT_MARGIN),
            Self::NetTravel | Self::PhaseWraps => Bounds::Unchecked,
            _ => Bounds::Both(FACTOR),
        }
    }

    /// The value; `None` if the phrase is too short.
    pub fn of(self, motion: &Phrase) -> Option<f64> {
        let frames = motion.frames();
        let nth = |order: usize| {
            let mut values = motion.vectors(POSITION);
            for _ in 0..order {
                values = differences(&values, FPS);
            }
            (!values.is_empty()).then(|| mean_norm(&values))
        };
        match self {
            Self::PathSpeed => nth(1),
            Self::FastestStep => {
                let velocity = differences(&motion.vectors(POSITION), FPS);
                largest(velocity.into_iter().map(length).collect())
            }
            Self::PathAcceleration => nth(2),
            Self::PathJerk => nth(3),
            Self::Travel => {
                let apart = (SECOND..frames).map(|t| floor_distance(motion, t - SECOND, t));
                mean(&apart.collect::<Vec<_>>())
            }
            Self::Height => (frames > 0).then(|| median(heights(motion))),
            Self::LowestHeight => largest(heights(motion).iter().map(|h| -h).collect()).map(|h| -h),
            Self::HighestHeight => largest(heights(motion)),
            Self::TurnRate => mean(&turns(motion)).map(|rate| rate * FPS),
            Self::TurnAcceleration => {
                let changes = differences(&angular_rates(motion), FPS);
                (!changes.is_empty()).then(|| mean_norm(&changes).to_degrees())
            }
            Self::LargestTurn => largest(turns(motion)),
            Self::LargestTilt => largest(tilts(motion)),
            Self::PhaseRate => mean(&phase_steps(motion)).map(|step| step * FPS),
            Self::LargestPhaseStep => largest(phase_steps(motion)),
            Self::LargestAcceleration => {
                let velocity = differences(&motion.vectors(POSITION), FPS);
                largest(
                    differences(&velocity, FPS)
                        .into_iter()
                        .map(length)
                        .collect(),
                )
            }
            Self::StillShare => {
                let velocity = differences(&motion.vectors(POSITION), FPS);
                let speeds = velocity.into_iter().map(length).zip(turns(motion));
                let still = speeds.map(|(speed, turn)| match (speed + turn).is_nan() {
                    true => f64::NAN,
                    false => f64::from(speed < STILL_SPEED && turn * FPS < STILL_TURN),
                });
                mean(&still.collect::<Vec<_>>())
            }
            Self::NetTravel => (frames > 1).then(|| floor_distance(motion, 0, frames - 1)),
            Self::PhaseWraps => (frames > 1).then(|| phase_wraps(motion)),
        }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The largest value, or NaN if a value is NaN; `None` without values.
fn largest(values: Vec<f64>) -> Option<f64> {
    // `f64::max` would ignore NaN.
    let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
    values.into_iter().reduce(larger)
}

fn floor_distance(motion: &Phrase, from: usize, to: usize) -> f64 {
    let [a, b] = [from, to].map(|t| motion.vector(t, POSITION));
    (b[0] - a[0]).hypot(b[2] - a[2])
}

/// Heights of the root, metres, `[frames]`.
fn heights(motion: &Phrase) -> Vec<f64> {
    motion.column(POSITION.start + 1)
}

/// Angles between neighbouring frames, degrees, `[frames - 1]`.
fn turns(motion: &Phrase) -> Vec<f64> {
    let degrees = |rate| (length(rate) / FPS).to_degrees();
    angular_rates(motion).into_iter().map(degrees).collect()
}

/// Angles between the body's upward axis and the vertical, degrees, `[frames]`.
fn tilts(motion: &Phrase) -> Vec<f64> {
    let tilt = |quaternion: Quaternion| {
        let unit = quaternion.scale(1.0 / quaternion.norm());
        let [x, y, z] = unit.rotate([0.0, 1.0, 0.0]);
        x.hypot(z).atan2(y).to_degrees()
    };
    motion.quaternions().into_iter().map(tilt).collect()
}

/// Shortest steps of the phase between frames, -0.5 to 0.5, `[frames - 1]`.
pub fn phase_steps(motion: &Phrase) -> Vec<f64> {
    let phases = motion.column(PHASE);
    let pairs = phases.windows(2);
    pairs.map(|pair| circular::step(pair[0], pair[1])).collect()
}

/// Number of bar lines that the phase passes, minus those that it passes backwards.
fn phase_wraps(motion: &Phrase) -> f64 {
    // A step of more than half a bar counts as a step in the other direction.
    let phases = motion.column(PHASE);
    let pairs = phases.windows(2);
    pairs.map(|pair| (pair[0] - pair[1]).round()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::derive;

    /// A phrase that walks along x at 0.6 m/s and turns about the vertical at 90 degrees per
    /// second, at half a bar per second.
    fn constant_motion(frames: usize) -> Phrase {
        let seconds = |t: usize| t as f64 / FPS;
        let positions: Vec<_> = (0..frames).map(|t| [0.6 * seconds(t), 1.0, 0.0]).collect();
        let turn = |t: usize| [0.0, std::f64::consts::FRAC_PI_2 * seconds(t), 0.0];
        let quaternions: Vec<_> = (0..frames)
            .map(|t| Quaternion::from_rotation_vector(turn(t)))
            .collect();
        let phase: Vec<_> = (0..frames).map(|t| (0.5 * seconds(t)).fract()).collect();
        derive(&positions, &quaternions, &phase, &vec![[0.0; 8]; frames]).unwrap()
    }

    #[test]
    fn constant_motion_has_its_values() {
        let motion = constant_motion(121);
        let expected = [
            0.6,
            0.6,
            0.0,
            0.0,
            0.6,
            1.0,
            1.0,
            1.0,
            90.0,
            0.0,
            3.0,
            0.0,
            0.5,
            0.5 / FPS,
            0.0,
            0.0,
            2.4,
            2.0,
        ];
        for (measure, expected) in MotionMeasure::ALL.into_iter().zip(expected) {
            let value = measure.of(&motion).unwrap();
            // Third differences amplify the rounding to single precision.
            let tolerance = match measure {
                MotionMeasure::PathJerk
                | MotionMeasure::TurnAcceleration
                | MotionMeasure::LargestAcceleration => 0.05,
                _ => 1e-3,
            };
            assert!((value - expected).abs() < tolerance, "{measure:?}: {value}");
        }
    }

    #[test]
    fn trembling_on_the_spot_is_a_path_without_travel() {
        let positions: Vec<_> = (0..61)
            .map(|t| [if t % 2 == 0 { 0.0 } else { 0.02 }, 1.0, 0.0])
            .collect();
        let still = vec![Quaternion::IDENTITY; 61];
        let motion = derive(&positions, &still, &[0.0; 61], &[[0.0; 8]; 61]).unwrap();
        assert!((MotionMeasure::PathSpeed.of(&motion).unwrap() - 0.6).abs() < 1e-6);
        assert_eq!(MotionMeasure::Travel.of(&motion), Some(0.0));
    }

    #[test]
    fn a_phase_that_wavers_at_the_end_of_the_bar_wraps_once() {
        let mut motion = constant_motion(7);
        for (t, phase) in [0.9, 0.98, 0.02, 0.97, 0.01, 0.05, 0.2]
            .into_iter()
            .enumerate()
        {
            motion.frame_mut(t)[PHASE] = phase;
        }
        assert_eq!(MotionMeasure::PhaseWraps.of(&motion), Some(1.0));
    }

    #[test]
    fn nan_is_not_skipped() {
        for channel in [0, 9, PHASE] {
            let mut motion = constant_motion(60);
            motion.frame_mut(20)[channel] = f32::NAN;
            let measures = match channel {
                0 => vec![
                    MotionMeasure::PathSpeed,
                    MotionMeasure::FastestStep,
                    MotionMeasure::PathJerk,
                    MotionMeasure::Travel,
                ],
                9 => vec![
                    MotionMeasure::TurnRate,
                    MotionMeasure::LargestTurn,
                    MotionMeasure::LargestTilt,
                ],
                _ => vec![MotionMeasure::PhaseRate, MotionMeasure::LargestPhaseStep],
            };
            for measure in measures {
                assert!(measure.of(&motion).unwrap().is_nan(), "{measure:?}");
            }
        }
    }

    #[test]
    fn explicit_derivatives_do_not_enter() {
        let mut motion = constant_motion(60);
        let before = MotionMeasure::ALL.map(|measure| measure.of(&motion));
        for t in 0..60 {
            motion.frame_mut(t)[crate::phrase::VELOCITY].fill(9.0);
            motion.frame_mut(t)[crate::phrase::ACCELERATION].fill(-9.0);
            motion.frame_mut(t)[crate::phrase::ANGULAR_VELOCITY].fill(5.0);
        }
        assert_eq!(
            MotionMeasure::ALL.map(|measure| measure.of(&motion)),
            before
        );
    }

    #[test]
    fn the_sign_of_a_quaternion_is_not_a_turn() {
        let mut motion = constant_motion(60);
        let before = MotionMeasure::TurnRate.of(&motion);
        motion.set_quaternion(30, motion.quaternion(30).scale(-1.0));
        let after = MotionMeasure::TurnRate.of(&motion);
        assert!((before.unwrap() - after.unwrap()).abs() < 1e-3);
    }

    #[test]
    fn the_tilt_is_that_of_the_body_whatever_its_heading() {
        let tilted = |tilt: f64| {
            let lean = Quaternion::from_rotation_vector([tilt.to_radians(), 0.0, 0.0]);
            let mut motion = constant_motion(60);
            let turned = Quaternion::from_yaw(2.0) * lean;
            motion.set_quaternion(30, turned.scale(-0.5));
            MotionMeasure::LargestTilt.of(&motion).unwrap()
        };
        for tilt in [0.0, 25.0, 90.0, 172.0] {
            assert!((tilted(tilt) - tilt).abs() < 1e-3, "{tilt}");
        }
    }

    #[test]
    fn a_jump_and_a_stop_are_measured() {
        let mut motion = constant_motion(60);
        let [x, y, z] = motion.vector(30, POSITION);
        motion.set_vector(30, POSITION, [x, y + 0.1, z]);
        // Up and down again by 10 cm within two steps.
        let jump = MotionMeasure::LargestAcceleration.of(&motion).unwrap();
        assert!((jump - 0.2 * FPS * FPS).abs() < 0.1, "{jump}");
        let mut stopped = constant_motion(61);
        let (place, turn) = (stopped.vector(30, POSITION), stopped.quaternion(30));
        for t in 31..61 {
            stopped.set_vector(t, POSITION, place);
            stopped.set_quaternion(t, turn);
        }
        assert_eq!(MotionMeasure::StillShare.of(&stopped), Some(0.5));
    }

    #[test]
    fn too_few_frames_have_no_value() {
        // From how many frames on each has one.
        let needed = [2, 2, 3, 4, 31, 1, 1, 1, 2, 3, 2, 1, 2, 2, 3, 2, 2, 2];
        for frames in [1, 2, 3, 4, 30, 31] {
            let motion = constant_motion(frames);
            for (measure, needed) in MotionMeasure::ALL.into_iter().zip(needed) {
                let known = measure.of(&motion).is_some();
                assert_eq!(known, frames >= needed, "{measure:?} of {frames}");
            }
        }
    }
}
