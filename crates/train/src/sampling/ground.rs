//! The root's path on the ground, compared with the training motion.

use kinegrad_motion::goal::Obstacle;
use kinegrad_motion::metrics::{Clearance, PathStep, clearance, fastest_step};
use kinegrad_settings::counted;
use serde::{Deserialize, Serialize};

/// The root's path of a sample, measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundRecord {
    /// Its fastest step; `None` of a single frame.
    pub fastest_step: Option<PathStep>,
    /// Speed of the fastest step of training along a ground axis, m/s.
    pub fastest_of_training: f64,
    /// Distance of the first frame from the origin, where clips start, metres.
    pub start: f64,
    /// Its clearance from the goal's obstacles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clearance: Option<Clearance>,
    /// Number of samples that were out of bounds before it and were replaced.
    #[serde(default)]
    pub rejected: usize,
    /// The path of a first stage, which the sample follows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_stage: Option<Box<GroundRecord>>,
}

impl GroundRecord {
    /// Largest speed of a step within the bounds, in fastest steps of training.
    pub const MOST: f64 = 1.5;
    /// Speed from which on a motion is called unusable, in fastest steps of training.
    pub const FAR: f64 = 3.0;
    /// Largest distance of the first frame from the origin within the bounds, metres.
    pub const START: f64 = 0.5;
    /// Depth in an obstacle that counts as much as twice another bound, metres.
    const DEEP: f64 = 0.1;

    /// Measures `ground` positions `[x, z]` in metres, `fps` a second.
    pub fn of(
        ground: &[[f64; 2]],
        obstacles: &[Obstacle],
        fps: f64,
        fastest_of_training: f64,
    ) -> Self {
        Self {
            fastest_step: fastest_step(ground, fps),
            fastest_of_training,
            start: ground.first().map_or(0.0, |[x, z]| x.hypot(*z)),
            clearance: clearance(ground, obstacles),
            rejected: 0,
            first_stage: None,
        }
    }

    /// Speed of the fastest step, in fastest steps of training.
    fn speed(&self) -> f64 {
        let speed = self.fastest_step.map_or(0.0, |step| step.speed);
        speed / self.fastest_of_training.max(f64::MIN_POSITIVE)
    }

    /// How far the path is out of bounds: 0 within them, infinite if it is not finite.
    pub fn excess(&self) -> f64 {
        let speed = (self.speed() / Self::MOST - 1.0).max(0.0);
        let start = (self.start / Self::START - 1.0).max(0.0);
        let depth = self.clearance.map_or(0.0, |clearance| -clearance.metres);
        let excess = speed + start + (depth / Self::DEEP).max(0.0);
        let is_finite = self.speed().is_finite() && self.start.is_finite();
        if is_finite { excess } else { f64::INFINITY }
    }

    /// True if the root moves faster than [`MOST`](Self::MOST) allows.
    pub fn is_fast(&self) -> bool {
        self.speed() > Self::MOST
    }

    /// True if the root is inside an obstacle, or crosses one, in a frame.
    pub fn is_inside(&self) -> bool {
        let inside = |clearance: Clearance| clearance.frames_inside > 0;
        self.clearance.is_some_and(inside)
    }

    /// True if the root moves faster than [`FAR`](Self::FAR) allows.
    pub fn is_far(&self) -> bool {
        self.speed() > Self::FAR
    }

    /// The warning about a path out of bounds; `name` is that of its sample.
    pub fn warning(&self, name: &str) -> Option<String> {
        let mut faults = Vec::new();
        if let Some(step) = self.fastest_step
            && self.is_fast()
        {
            let verdict = match self.is_far() {
                true => ": this motion is not usable",
                false => "",
            };
            let (speed, frame, ratio) = (step.speed, step.frame, self.speed());
            let most = self.fastest_of_training;
            faults.push(format!(
                "the root moves {ratio:.1} times the fastest step of training ({speed:.2}, not \
                 {most:.2} m/s) in frame {frame}{verdict}"
            ));
        }
        if let Some(clearance) = self.clearance
            && self.is_inside()
        {
            faults.push(format!(
                "the root is inside an obstacle, or crosses it, in {}, deepest in frame {} ({:.3} m)",
                counted(clearance.frames_inside, "frame"),
                clearance.frame,
                -clearance.metres,
            ));
        }
        if self.start > Self::START {
            let start = self.start;
            faults.push(format!("the first frame is {start:.2} m from the origin"));
        }
        let own = (!faults.is_empty()).then(|| format!("{name}: {}", faults.join("; ")));
        let name = format!("{name}, first stage");
        let first = self
            .first_stage
            .as_ref()
            .and_then(|path| path.warning(&name));
        own.into_iter()
            .chain(first)
            .reduce(|own, first| format!("{own}; {first}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(ground: &[[f64; 2]]) -> GroundRecord {
        let obstacle = Obstacle::Disc {
            x: 0.0,
            z: 2.0,
            radius: 0.3,
        };
        GroundRecord::of(ground, &[obstacle], 20.0, 1.6)
    }

    #[test]
    fn a_path_out_of_bounds_is_reported_with_its_frame() {
        let good = record(&[[0.0, 0.0], [0.0, 0.1], [0.0, 0.2]]);
        assert_eq!((good.excess(), good.warning("walk")), (0.0, None));
        // 3.2 m/s is twice the fastest step.
        let fast = record(&[[0.0, 0.0], [0.0, 0.1], [0.0, 0.26]]);
        let text = fast.warning("walk").expect("too fast");
        assert!(
            text.starts_with("walk: the root moves 2.0 times the fastest step of training (3.20, not 1.60 m/s) in frame 2"),
            "{text}"
        );
        assert!(!text.contains("not usable"), "{text}");
        // Over the obstacle in one step, from a start far away.
        let hop = record(&[[0.0, 0.9], [0.0, 1.0], [0.0, 3.0]]);
        let text = hop.warning("walk").expect("out of bounds");
        for part in [
            "not usable",
            "in 1 frame, deepest in frame 2 (0.300 m)",
            "0.90 m from the origin",
        ] {
            assert!(text.contains(part), "{text}");
        }
        assert!(hop.excess() > fast.excess());
        // To graze an obstacle in many frames is better than to dash.
        let graze: Vec<[f64; 2]> = (0..60)
            .map(|i| [0.29, 1.41 + 0.02 * f64::from(i)])
            .collect();
        let graze = GroundRecord {
            start: 0.0,
            ..record(&graze)
        };
        let dash = record(&[[0.0, 0.0], [0.0, 0.1], [0.6, 0.1]]);
        assert!(graze.excess() > 0.0 && graze.excess() < dash.excess());
        let broken = record(&[[0.0, 0.0], [f64::NAN, 0.0]]);
        assert_eq!(broken.excess(), f64::INFINITY);
    }
}
