//! Foot contacts.

use std::ops::Range;

use crate::derivatives::forward_differences;
use crate::metrics::{SKATING_HEIGHT, SKATING_SPEED};
use crate::vector::{length, minus};

/// Foot contacts by the position of the sole.
///
/// A contact needs one low and slow frame, and extends with looser thresholds (hysteresis).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRule {
    /// Largest height of the sole above the floor in the low and slow frame, metres.
    pub height: f64,
    /// Largest speed of the sole in that frame, metres per second.
    pub speed: f64,
    /// Factor of both thresholds for the rest of the contact.
    pub lasting: f64,
    /// Shortest contact and shortest gap, seconds.
    pub shortest: f64,
}

impl Default for ContactRule {
    /// Height of the skating measure, 1.5 times its speed, and an eighth of a second.
    fn default() -> Self {
        Self {
            height: SKATING_HEIGHT,
            speed: 1.5 * SKATING_SPEED,
            lasting: 1.5,
            shortest: 0.125,
        }
    }
}

impl ContactRule {
    /// Contacts `[frames]` of a sole at `path`, `[frames, 3]`, metres with +y up, at `fps` frames
    /// per second above a `floor`. The speed of a frame is the speed of the slower adjacent step.
    pub fn contacts(&self, path: &[[f64; 3]], fps: f64, floor: f64) -> Vec<bool> {
        let pairs = path.windows(2);
        let steps = pairs.map(|pair| length(minus(pair[1], pair[0])) * fps);
        let steps: Vec<f64> = steps.collect();
        let speed = |t: usize| {
            let around = steps[t.saturating_sub(1)..(t + 1).min(steps.len())].iter();
            around.copied().fold(f64::INFINITY, f64::min)
        };
        let within = |factor: f64| -> Vec<bool> {
            let low = |t: usize| path[t][1] - floor < factor * self.height;
            let stands = |t: usize| low(t) && speed(t) < factor * self.speed;
            (0..path.len()).map(stands).collect()
        };
        let certain = within(1.0);
        let mut contacts = within(self.lasting.max(1.0));
        for run in runs(&contacts) {
            if !certain[run.clone()].contains(&true) {
                contacts[run].fill(false);
            }
        }
        let shortest = (self.shortest * fps).ceil().max(1.0) as usize;
        without_short_runs(contacts, shortest)
    }
}

/// Published rules for contacts of a joint, by height and step to the next frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepRule {
    /// A low position and a short step (docs/sources.md, section 7, "Edge Considerations").
    HeightAndStep {
        /// Largest height above the floor.
        height: f64,
        /// Longest step.
        step: f64,
    },
    /// A short vertical and horizontal step, at any height (docs/sources.md, section 7, option A).
    VerticalAndHorizontal {
        /// Largest vertical step.
        vertical: f64,
        /// Largest horizontal step.
        horizontal: f64,
    },
    /// A squared step below this value, as in HumanML3D.
    SquaredStep(f64),
    /// A step of at most this length, as in foot-contact losses.
    Step(f64),
}

impl StepRule {
    /// The thresholds of this project.
    pub const LOW_AND_SLOW: Self = Self::HeightAndStep {
        height: 0.12,
        step: 0.03,
    };

    /// Contacts of the joint at `path`, `[frames, 3]`, above a floor at height `floor`.
    pub fn contacts(&self, path: &[[f64; 3]], floor: f64) -> Vec<bool> {
        let stands = |(here, [x, y, z]): (&[f64; 3], [f64; 3])| match *self {
            Self::HeightAndStep { height, step } => {
                here[1] - floor < height && length([x, y, z]) < step
            }
            Self::VerticalAndHorizontal {
                vertical,
                horizontal,
            } => y.abs() < vertical && x.hypot(z) < horizontal,
            Self::SquaredStep(squared) => x * x + y * y + z * z < squared,
            Self::Step(step) => length([x, y, z]) <= step,
        };
        path.iter().zip(steps(path)).map(stands).collect()
    }
}

/// Steps to the next frame, the last one repeated; zero for a single frame.
pub fn steps(path: &[[f64; 3]]) -> Vec<[f64; 3]> {
    forward_differences(path, 1.0)
}

/// Runs of frames in contact, in order.
pub fn runs(contacts: &[bool]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (t, _) in contacts.iter().enumerate().filter(|(_, contact)| **contact) {
        match runs.last_mut() {
            Some(run) if run.end == t => run.end = t + 1,
            _ => runs.push(t..t + 1),
        }
    }
    runs
}

/// Closes gaps of fewer than `shortest` frames, then removes contacts of fewer.
pub fn without_short_runs(mut contacts: Vec<bool>, shortest: usize) -> Vec<bool> {
    for value in [false, true] {
        let mut first = 0;
        for t in 0..=contacts.len() {
            if t < contacts.len() && contacts[t] == value {
                continue;
            }
            // Gaps at either end stay.
            let inside = value || first > 0 && t < contacts.len();
            if inside && t - first < shortest {
                contacts[first..t].fill(!value);
            }
            first = t + 1;
        }
    }
    contacts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Vec<bool> {
        text.chars().map(|c| c == '#').collect()
    }

    #[test]
    fn short_gaps_and_short_contacts_go() {
        for (found, expected) in [
            ("..####.###..", "..########.."),
            (".##....####", ".......####"),
            ("###...###", "###...###"),
            (".##.##.", ".#####."),
        ] {
            assert_eq!(
                without_short_runs(read(found), 3),
                read(expected),
                "{found}"
            );
        }
        assert_eq!(runs(&read(".##...#")), [1..3, 6..7]);
        assert!(runs(&read("...")).is_empty());
    }

    /// A sole with these heights and steps after each frame, in centimetres.
    fn path(heights: &[f64], steps: &[f64]) -> Vec<[f64; 3]> {
        let mut x = 0.0;
        let mut place = |(height, step): (&f64, &f64)| {
            let here = [0.01 * x, 0.01 * height, 0.0];
            x += step;
            here
        };
        heights.iter().zip(steps).map(&mut place).collect()
    }

    #[test]
    fn low_and_slow_soles_stand_until_they_leave() {
        let rule = ContactRule::default();
        let at = |heights: &[f64], steps: &[f64]| rule.contacts(&path(heights, steps), 20.0, 0.0);
        // 3.75 cm per frame are 0.75 m/s. A contact begins in the frame at the end of a quick step.
        let steps = [9.0, 9.0, 1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 9.0, 9.0];
        assert_eq!(at(&[2.0; 10], &steps), read("..#######."));
        // The sole is quick but does not swing; the second sole is slow enough once.
        assert_eq!(at(&[2.0; 6], &[4.0; 6]), read("......"));
        assert_eq!(
            at(&[2.0; 6], &[4.0, 4.0, 3.0, 5.0, 6.0, 9.0]),
            read("#####.")
        );
        // The height suffices to extend a contact, but not to start one.
        assert_eq!(at(&[6.0; 10], &steps), read(".........."));
        let rising = [6.0, 6.0, 6.0, 4.9, 6.0, 6.0, 7.4, 8.0, 8.0, 8.0];
        assert_eq!(at(&rising, &steps), read("..#####..."));
        // The sole is always slow, then slow for only two frames.
        assert_eq!(at(&[2.0; 4], &[0.0; 4]), read("####"));
        let short = [9.0, 0.0, 9.0, 9.0, 9.0];
        assert_eq!(at(&[2.0; 5], &short), read("....."));
        // Above another floor.
        let raised = path(&[102.0; 4], &[0.0; 4]);
        assert_eq!(rule.contacts(&raised, 20.0, 0.0), [false; 4]);
        assert_eq!(rule.contacts(&raised, 20.0, 1.0), [true; 4]);
        assert!(rule.contacts(&[], 20.0, 0.0).is_empty());
        assert_eq!(rule.contacts(&raised[..1], 20.0, 1.0), [false]);
    }
}
