//! Metrics of motions with goals.

use kinegrad_settings::counted;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::{
    Clearance, FeatureMoments, clearance, fastest_step, feature_diversity, frechet_distance, mean,
    mean_jerk, skating_ratio, sliding_ratio,
};
use crate::goal::Goal;
use crate::humanml::Joints;

/// One generated motion and its goal.
#[derive(Clone, Copy, Debug)]
pub struct GoalSample<'a> {
    /// The goal.
    pub goal: &'a Goal,
    /// Ground positions `[x, z]` of the root, metres, at least for all frames of the goal.
    pub ground: &'a [[f64; 2]],
    /// The body, if known.
    pub joints: Option<&'a Joints>,
}

/// Distance in metres of the root from each target of the goal, in the order of frames.
pub fn keyframe_distances(goal: &Goal, ground: &[[f64; 2]]) -> Vec<f64> {
    let distance =
        |(frame, [x, z]): (usize, [f64; 2])| (ground[frame][0] - x).hypot(ground[frame][1] - z);
    goal.points().masked().map(distance).collect()
}

/// Goal errors of generated motions, and their quality. A metric without data or with values that
/// are not finite is `None`. The thresholds are standard in the field.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct GoalReport {
    /// Number of motions.
    pub samples: usize,
    /// Number of target positions.
    pub keyframes: usize,
    /// Share of the motions with keyframes that miss a keyframe by more than 20 cm.
    pub trajectory_error_20cm: Option<f64>,
    /// Share of the motions with keyframes that miss a keyframe by more than 50 cm.
    pub trajectory_error_50cm: Option<f64>,
    /// Share of all keyframes that are missed by more than 20 cm.
    pub location_error_20cm: Option<f64>,
    /// Share of all keyframes that are missed by more than 50 cm.
    pub location_error_50cm: Option<f64>,
    /// Mean distance from the keyframes of all motions, metres.
    pub average_error: Option<f64>,
    /// Mean over motions of [`skating_ratio`], as published.
    pub foot_skating: Option<f64>,
    /// Mean over motions of [`sliding_ratio`], which also counts single quick steps.
    #[serde(default)]
    pub foot_sliding: Option<f64>,
    /// Mean over motions of [`mean_jerk`], metres per second cubed.
    pub jerk: Option<f64>,
    /// Share of the frames of all motions with obstacles in which the root is inside one, or reached
    /// by a step across one.
    pub inside_obstacles: Option<f64>,
    /// Smallest distance of a root from an obstacle, in and between frames, metres.
    #[serde(default)]
    pub clearance: Option<f64>,
    /// Speed of the fastest step of a root on the ground, of all motions, m/s.
    #[serde(default)]
    pub fastest_step: Option<f64>,
    /// [`feature_diversity`], from [`with_features`](Self::with_features).
    pub diversity: Option<f64>,
    /// [`frechet_distance`] from real motion, from [`with_features`](Self::with_features).
    pub frechet_distance: Option<f64>,
}

impl GoalReport {
    /// Measures motions of `fps` frames per second; `feet` are the joints of the toes.
    pub fn compute(samples: &[GoalSample], fps: f64, feet: &[usize]) -> Self {
        let distances = samples.iter().map(|s| keyframe_distances(s.goal, s.ground));
        let distances = distances.filter(|distances| !distances.is_empty());
        let distances: Vec<Vec<f64>> = distances.collect();
        let all: Vec<f64> = distances.concat();
        let finite = all.iter().all(|distance| distance.is_finite());
        let missed_motions = |threshold: f64| {
            let missed = |of: &&Vec<f64>| of.iter().any(|distance| *distance > threshold);
            share(distances.iter().filter(missed).count(), distances.len()).filter(|_| finite)
        };
        let missed_keyframes = |threshold: f64| {
            let missed = all.iter().filter(|distance| **distance > threshold);
            share(missed.count(), all.len()).filter(|_| finite)
        };
        let bodies = || samples.iter().filter_map(|sample| sample.joints);
        let paths = || samples.iter().map(|s| (s.goal, &s.ground[..s.goal.frames]));
        let clearances = paths().filter_map(|(goal, path)| {
            let found = clearance(path, &goal.obstacles)?;
            Some((found, path.len()))
        });
        let clearances: Vec<(Clearance, usize)> = clearances.collect();
        let inside = clearances.iter().map(|(found, _)| found.frames_inside);
        let frames = clearances.iter().map(|(_, frames)| frames);
        let nearest = most(clearances.iter().map(|(found, _)| -found.metres)).map(|most| -most);
        let steps = paths().filter_map(|(_, path)| fastest_step(path, fps));
        Self {
            samples: samples.len(),
            keyframes: all.len(),
            trajectory_error_20cm: missed_motions(0.2),
            trajectory_error_50cm: missed_motions(0.5),
            location_error_20cm: missed_keyframes(0.2),
            location_error_50cm: missed_keyframes(0.5),
            average_error: mean(all.iter().copied().map(Some)),
            foot_skating: mean(bodies().map(|joints| skating_ratio(joints, fps, feet))),
            foot_sliding: mean(bodies().map(|joints| sliding_ratio(joints, fps, feet))),
            jerk: mean(bodies().map(|joints| mean_jerk(joints, fps))),
            inside_obstacles: share(inside.sum(), frames.sum()).filter(|_| nearest.is_some()),
            clearance: nearest,
            fastest_step: most(steps.map(|step| step.speed)),
            ..Self::default()
        }
    }

    /// Adds the metrics of feature vectors `[n, features]` of generated and real motions: diversity
    /// over `pairs` random pairs, and the Fréchet distance.
    #[must_use]
    pub fn with_features(
        mut self,
        generated: &[Vec<f64>],
        real: &[Vec<f64>],
        pairs: usize,
        seed: u64,
    ) -> Self {
        self.diversity = feature_diversity(generated, pairs, seed);
        let moments = FeatureMoments::compute(generated).zip(FeatureMoments::compute(real));
        self.frechet_distance = moments.map(|(a, b)| frechet_distance(&a, &b));
        self
    }

    /// The metrics in print order, with name and unit.
    pub fn rows(&self) -> [(&'static str, Option<f64>, &'static str); 13] {
        [
            ("trajectory error, 20 cm", self.trajectory_error_20cm, ""),
            ("trajectory error, 50 cm", self.trajectory_error_50cm, ""),
            ("location error, 20 cm", self.location_error_20cm, ""),
            ("location error, 50 cm", self.location_error_50cm, ""),
            ("average error", self.average_error, " m"),
            ("foot skating", self.foot_skating, ""),
            ("foot sliding", self.foot_sliding, ""),
            ("mean jerk", self.jerk, " m/s^3"),
            ("inside obstacles", self.inside_obstacles, ""),
            ("clearance", self.clearance, " m"),
            ("fastest root step", self.fastest_step, " m/s"),
            ("diversity", self.diversity, ""),
            ("Fréchet distance", self.frechet_distance, ""),
        ]
    }
}

impl fmt::Display for GoalReport {
    /// One line for each available metric.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let keyframes = counted(self.keyframes, "keyframe");
        write!(f, "{}, {keyframes}", counted(self.samples, "motion"))?;
        for (name, value, unit) in self.rows() {
            if let Some(value) = value {
                write!(f, "\n{name:<24} {value:>9.4}{unit}")?;
            }
        }
        Ok(())
    }
}

/// The largest value; `None` of nothing, and if one is not finite.
fn most(values: impl Iterator<Item = f64>) -> Option<f64> {
    let largest = values.map(|value| if value.is_nan() { f64::INFINITY } else { value });
    largest.reduce(f64::max).filter(|value| value.is_finite())
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goal::{Keyframe, Obstacle};

    fn goal(frames: usize, keyframes: &[(usize, f64, f64)]) -> Goal {
        let mut goal = Goal::new(frames);
        let keyframe = |&(frame, x, z): &(usize, f64, f64)| Keyframe { frame, x, z };
        goal.keyframes = keyframes.iter().map(keyframe).collect();
        goal
    }

    fn sample<'a>(goal: &'a Goal, ground: &'a [[f64; 2]]) -> GoalSample<'a> {
        GoalSample {
            goal,
            ground,
            joints: None,
        }
    }

    #[test]
    fn misses_count_by_motion_and_by_key_frame() {
        let still = [[0.0; 2]; 4];
        // The misses are 0.1 m and 0.5 m exactly; 0.3 m; 0.6, 0 and 0 m.
        let goals = [
            goal(4, &[(3, 0.3, 0.4), (0, 0.1, 0.0)]),
            goal(2, &[(1, 0.0, -0.3)]),
            goal(4, &[(0, 0.6, 0.0), (1, 0.0, 0.0), (2, 0.0, 0.0)]),
            goal(4, &[]),
        ];
        assert_eq!(keyframe_distances(&goals[0], &still), [0.1, 0.5]);
        let samples: Vec<_> = goals.iter().map(|goal| sample(goal, &still)).collect();
        let report = GoalReport::compute(&samples, 2.0, &[]);
        assert_eq!((report.samples, report.keyframes), (4, 6));
        assert_eq!(report.trajectory_error_20cm, Some(1.0));
        assert_eq!(report.trajectory_error_50cm, Some(1.0 / 3.0));
        assert_eq!(report.location_error_20cm, Some(0.5));
        assert_eq!(report.location_error_50cm, Some(1.0 / 6.0));
        assert!((report.average_error.unwrap() - 1.5 / 6.0).abs() < 1e-12);
        assert_eq!(report.inside_obstacles, None);
        assert_eq!((report.foot_skating, report.jerk), (None, None));
        assert_eq!(report.diversity, None);
    }

    #[test]
    fn frames_inside_of_any_obstacle_count_once() {
        let mut goal = goal(4, &[]);
        let disc = |x, radius| Obstacle::Disc { x, z: 0.0, radius };
        goal.obstacles = vec![disc(0.0, 1.0), disc(0.5, 1.0)];
        goal.margin = 3.0;
        let ground = [[0.2, 0.0], [1.4, 0.0], [1.5, 0.0], [9.0, 0.0], [0.0, 0.0]];
        let free = Goal::new(4);
        let samples = [sample(&goal, &ground), sample(&free, &ground)];
        let report = GoalReport::compute(&samples, 2.0, &[]);
        assert_eq!(report.inside_obstacles, Some(0.5));
        // Between frames 0 and 1, the path crosses the centre of the second disc.
        assert_eq!(report.clearance, Some(-1.0));
        assert_eq!(report.fastest_step, Some(15.0));
        assert_eq!(report.location_error_20cm, None);
        let broken = [[f64::NAN, 0.0]; 4];
        let report = GoalReport::compute(&[sample(&goal, &broken)], 2.0, &[]);
        assert_eq!(report.inside_obstacles, None);
    }

    #[test]
    fn broken_positions_have_no_errors() {
        let goal = goal(2, &[(1, 0.0, 0.0)]);
        let ground = [[0.0; 2], [f64::NAN, 0.0]];
        let report = GoalReport::compute(&[sample(&goal, &ground)], 2.0, &[]);
        assert_eq!(report.keyframes, 1);
        assert_eq!(report.average_error, None);
        assert_eq!(report.trajectory_error_50cm, None);
        assert_eq!(report.location_error_50cm, None);
    }

    #[test]
    fn bodies_and_features_enter_the_report() {
        let goal = goal(4, &[(0, 0.0, 0.0)]);
        // One joint slides by 1 m per frame, at 2 frames per second.
        let track: Vec<_> = (0..4).map(|t| [f64::from(t), 0.0, 0.0]).collect();
        let track = Joints::new(track, 1).unwrap();
        let joints = Some(&track);
        let ground = [[0.0; 2]; 4];
        let sliding = GoalSample {
            joints,
            ..sample(&goal, &ground)
        };
        let stand = Joints::new(vec![[0.0; 3]; 4], 1).unwrap();
        let standing = GoalSample {
            joints: Some(&stand),
            ..sliding
        };
        let report = GoalReport::compute(&[sliding, standing, sample(&goal, &ground)], 2.0, &[0]);
        assert_eq!(
            (report.foot_skating, report.foot_sliding),
            (Some(0.5), Some(0.5))
        );
        assert_eq!(report.jerk, Some(0.0));
        let features = |shift: f64| vec![vec![shift], vec![shift + 2.0]];
        let report = report.with_features(&features(0.0), &features(3.0), 9, 0);
        assert_eq!(report.diversity, Some(2.0));
        assert!((report.frechet_distance.unwrap() - 9.0).abs() < 1e-9);
        let json = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<GoalReport>(&json).unwrap(), report);
        let printed = report.to_string();
        assert!(printed.starts_with("3 motions, 3 keyframes\n"));
        assert!(
            printed.contains("\nfoot skating                0.5000\n"),
            "{printed}"
        );
        assert!(!printed.contains("obstacles"));
    }
}
