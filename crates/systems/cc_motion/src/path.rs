//! A ground path that the root of a phrase follows (docs/sources.md, section 7, options B and D).
//!
//! Like training phrases, the path is moved to the origin in each window, and not turned.

use std::ops::Range;
use std::path::PathBuf;

use kinegrad_motion::path::{PathPlan, PathReport};
use kinegrad_motion::phrase::{ACCELERATION, FPS, POSITION, VELOCITY};
use kinegrad_motion::stitch::Windows;
use kinegrad_motion::{Phrase, Statistics};
use kinegrad_settings::{InvalidSetting, in_range};
use kinegrad_train::Error;
use kinegrad_train::clips::path_target::{Fastest, PathTarget};
use kinegrad_train::sampling::PathRecord;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::to_value;

/// The table `evaluation.path`: path following of phrases in `kinegrad sample --path`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhrasePathConfig {
    /// The method that keeps the root on the path during sampling.
    pub method: PhrasePathMethod,
    /// For `guidance`: length of a step against the gradient of the squared distance of the
    /// predicted clean motion's ground position, velocity and acceleration from those of the path;
    /// 0.5 reaches the path.
    pub guidance_step_size: f64,
    /// For `guidance`: largest distance from the path without a loss, in meters.
    pub tolerance: f64,
    /// Last timestep at which the path acts. With `override`, final positions lie on the path for
    /// any value.
    pub stop_timestep: usize,
}

impl Default for PhrasePathConfig {
    fn default() -> Self {
        Self {
            method: PhrasePathMethod::default(),
            guidance_step_size: 0.4,
            tolerance: 0.0,
            stop_timestep: 0,
        }
    }
}

/// The path-following method of phrases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PhrasePathMethod {
    /// Replaces ground position, velocity and acceleration in the predicted clean motion at each
    /// step (option B).
    #[default]
    Override,
    /// Moves the predicted clean motion against the distance's gradient at each step (option D).
    Guidance,
}

impl PhrasePathConfig {
    /// # Errors
    /// Names the key that is invalid for the number of timesteps.
    pub fn validate(&self, num_train_timesteps: usize) -> Result<(), InvalidSetting> {
        in_range("guidance_step_size", self.guidance_step_size, 0.0..)?;
        in_range("tolerance", self.tolerance, 0.0..)?;
        in_range("stop_timestep", self.stop_timestep, 0..num_train_timesteps)
    }
}

/// A path for each frame of a phrase.
#[derive(Clone, Debug)]
pub struct PhrasePath {
    config: PhrasePathConfig,
    /// x and z in meters, `[frames]`.
    points: Vec<[f64; 2]>,
}

/// The path of a request, for one phrase.
pub(super) struct PathCondition {
    file: PathBuf,
    plan: PathPlan,
    target: PathTarget,
    /// The path, in the coordinates of sampling.
    pub followed: PhrasePath,
}

impl PathCondition {
    /// The path in a file, for `frames` frames.
    pub fn new(
        (file, plan): &(PathBuf, PathPlan),
        frames: usize,
        config: &PhrasePathConfig,
    ) -> Result<Self, Error> {
        let target = PathTarget::new(plan, frames, FPS)?;
        Ok(Self {
            file: file.clone(),
            plan: plan.clone(),
            followed: PhrasePath::new(&target, config.clone()),
            target,
        })
    }

    /// The warning about a path that exceeds training phrases with these statistics.
    pub fn too_fast(&self, statistics: &Statistics) -> Option<String> {
        let fastest = Fastest::of(statistics, VELOCITY.start, 1.0);
        self.target.too_fast(&self.file, FPS, fastest)
    }

    /// The record of a phrase.
    pub fn record(&self, motion: &Phrase) -> PathRecord {
        let frames = (0..motion.frames()).map(|t| motion.frame(t));
        let track = frames.map(|frame| GROUND.map(|axis| f64::from(frame[POSITION.start + axis])));
        let track: Vec<[f64; 2]> = track.collect();
        PathRecord {
            file: self.file.clone(),
            content: self.plan.clone(),
            settings: Some(to_value(&self.followed.config).expect("plain data")),
            report: PathReport::of_root(&track, &self.target.line, &self.target.course),
        }
    }
}

/// The axes of the ground.
const GROUND: [usize; 2] = [0, 2];

impl PhrasePath {
    /// The path of a target, followed according to `config`.
    pub fn new(target: &PathTarget, config: PhrasePathConfig) -> Self {
        Self {
            config,
            points: target.course.points.clone(),
        }
    }

    /// Moves normalized predicted clean windows, `[windows, channels, frames of a window]`, onto
    /// the path with `override`, and a step towards it with `guidance`.
    pub fn lead(
        &self,
        predicted: &mut [f32],
        windows: &Windows,
        statistics: &Statistics,
        timestep: usize,
    ) {
        if timestep < self.config.stop_timestep {
            return;
        }
        let length = windows.length();
        let channels = predicted.len() / (windows.len() * length);
        let all = channels_of(&self.points);
        for window in 0..windows.len() {
            let targets = of_window(&all, windows.of(window));
            let at = |channel: usize, t: usize| (window * channels + channel) * length + t;
            for t in 0..length {
                let metres = targets.iter().map(|(channel, values)| {
                    let value = f64::from(predicted[at(*channel, t)]) * statistics.std[*channel];
                    (*channel, value + statistics.mean[*channel] - values[t])
                });
                let metres = metres.filter(|(channel, _)| POSITION.contains(channel));
                let share = self.share(metres.fold(0.0, |sum: f64, (_, away)| sum.hypot(away)));
                for (channel, values) in &targets {
                    let target = (values[t] - statistics.mean[*channel]) / statistics.std[*channel];
                    let value = &mut predicted[at(*channel, t)];
                    *value = ((1.0 - share) * f64::from(*value) + share * target) as f32;
                }
            }
        }
    }

    /// The share of the distance to the path, in metres, by which a prediction moves.
    fn share(&self, distance: f64) -> f64 {
        match self.config.method {
            PhrasePathMethod::Override => 1.0,
            PhrasePathMethod::Guidance => {
                let over = (distance - self.config.tolerance).max(0.0);
                // The gradient of a square is twice the distance; a longer step would overshoot.
                let step = 2.0 * self.config.guidance_step_size * over;
                if over > 0.0 {
                    (step / distance).min(1.0)
                } else {
                    0.0
                }
            }
        }
    }

    /// Moves a phrase to the start of the path; with `override`, onto the path in every frame.
    pub fn finish(&self, motion: &mut Phrase) {
        let start = self.points[0];
        for t in 0..motion.frames() {
            let frame = motion.frame_mut(t);
            for (axis, start) in GROUND.into_iter().zip(start) {
                frame[POSITION.start + axis] += start as f32;
            }
        }
        if self.config.method != PhrasePathMethod::Override {
            return;
        }
        for (channel, values) in channels_of(&self.points) {
            for (t, value) in values.into_iter().enumerate() {
                motion.frame_mut(t)[channel] = value as f32;
            }
        }
    }
}

/// Ground position, velocity and acceleration of a root at `points`, with channel indices.
fn channels_of(points: &[[f64; 2]]) -> Vec<(usize, Vec<f64>)> {
    let change = |values: &[f64]| -> Vec<f64> {
        let changes = values.windows(2).map(|pair| FPS * (pair[1] - pair[0]));
        let mut changes: Vec<f64> = changes.collect();
        // The last frame repeats the previous frame's derivatives.
        changes.push(changes.last().copied().unwrap_or(0.0));
        changes
    };
    let of_axis = |(i, axis): (usize, usize)| {
        let position: Vec<f64> = points.iter().map(|point| point[i]).collect();
        let velocity = change(&position);
        let acceleration = change(&velocity);
        [
            (POSITION.start + axis, position),
            (VELOCITY.start + axis, velocity),
            (ACCELERATION.start + axis, acceleration),
        ]
    };
    GROUND.into_iter().enumerate().flat_map(of_axis).collect()
}

/// The channels in the frames of a window, with positions relative to the window's start.
fn of_window(all: &[(usize, Vec<f64>)], frames: Range<usize>) -> Vec<(usize, Vec<f64>)> {
    let of_channel = |(channel, values): &(usize, Vec<f64>)| {
        let values = &values[frames.clone()];
        let origin = match POSITION.contains(channel) {
            true => values[0],
            false => 0.0,
        };
        (
            *channel,
            values.iter().map(|value| value - origin).collect(),
        )
    };
    all.iter().map(of_channel).collect()
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::phrase::CHANNELS;

    use super::*;

    fn path(method: PhrasePathMethod, frames: usize) -> PhrasePath {
        let points = (0..frames).map(|t| [2.0 + 0.01 * t as f64, -0.02 * t as f64]);
        let target = PathTarget::through(points.collect()).unwrap();
        let config = PhrasePathConfig {
            method,
            stop_timestep: 10,
            ..PhrasePathConfig::default()
        };
        PhrasePath::new(&target, config)
    }

    fn statistics() -> Statistics {
        let mean = (0..CHANNELS).map(|c| 0.1 * c as f64).collect();
        Statistics::new(mean, vec![0.5; CHANNELS], None).unwrap()
    }

    #[test]
    fn predicted_windows_have_the_path_from_their_own_beginning() {
        let (windows, statistics) = (Windows::new(90, 60), statistics());
        let path = path(PhrasePathMethod::Override, 90);
        let mut values = vec![7.0f32; windows.len() * CHANNELS * 60];
        path.lead(&mut values, &windows, &statistics, 9);
        assert!(
            values.iter().all(|value| *value == 7.0),
            "below `stop_timestep`"
        );
        path.lead(&mut values, &windows, &statistics, 10);
        for window in values.chunks(CHANNELS * 60) {
            let channel = |c: usize, t: usize| {
                f64::from(window[c * 60 + t]) * statistics.std[c] + statistics.mean[c]
            };
            for t in [0, 30, 59] {
                assert!((channel(0, t) - 0.01 * t as f64).abs() < 1e-6);
                assert!((channel(2, t) + 0.02 * t as f64).abs() < 1e-6);
                assert!((channel(3, t) - 0.3).abs() < 1e-5 && (channel(5, t) + 0.6).abs() < 1e-5);
                assert!(channel(6, t).abs() < 1e-4 && channel(8, t).abs() < 1e-4);
                assert_eq!(window[60 + t], 7.0, "the height is the model's");
            }
        }
    }

    #[test]
    fn guidance_leads_nearer_to_the_path_and_nothing_else_moves() {
        let (windows, statistics) = (Windows::new(40, 40), statistics());
        let mut path = path(PhrasePathMethod::Guidance, 40);
        let predicted = vec![1.5f32; CHANNELS * 40];
        let led = |path: &PhrasePath, timestep: usize| {
            let mut values = predicted.clone();
            path.lead(&mut values, &windows, &statistics, timestep);
            values
        };
        assert_eq!(led(&path, 9), predicted, "below `stop_timestep`");
        let away = |values: &[f32]| -> f64 {
            let place =
                |c: usize, t: usize| f64::from(values[c * 40 + t]) * 0.5 + statistics.mean[c];
            let distances = (0..40).map(|t| {
                let (x, z) = (0.01 * t as f64, -0.02 * t as f64);
                (place(0, t) - x).hypot(place(2, t) - z)
            });
            distances.sum()
        };
        // The distance decreases by the share 2 guidance_step_size, because the loss is a square.
        for (size, expected) in [(0.0, 1.0), (0.2, 0.6), (0.5, 0.0), (3.0, 0.0)] {
            path.config.guidance_step_size = size;
            let moved = led(&path, 500);
            let share = away(&moved) / away(&predicted);
            assert!((share - expected).abs() < 1e-6, "{size}: {share}");
            // Ground position, velocity and acceleration.
            let ground = |index: usize| [0, 2, 3, 5, 6, 8].contains(&(index / 40));
            let pairs = moved.iter().zip(&predicted).enumerate();
            let mut others = pairs.filter(|(index, _)| !ground(*index));
            assert!(others.all(|(_, (moved, before))| moved == before));
        }
        path.config.tolerance = 100.0;
        assert_eq!(led(&path, 500), predicted, "within the tolerance");
    }

    #[test]
    fn a_sample_begins_where_the_path_does() {
        let mut motion = Phrase::new(vec![0.25; CHANNELS * 20]).unwrap();
        path(PhrasePathMethod::Guidance, 20).finish(&mut motion);
        assert_eq!(motion.frame(5)[..3], [2.25, 0.25, 0.25]);
        path(PhrasePathMethod::Override, 20).finish(&mut motion);
        assert_eq!(motion.frame(5)[..3], [2.05, 0.25, -0.1]);
        assert!((motion.frame(5)[3] - 0.3).abs() < 1e-5);
        assert_eq!(motion.frame(5)[9], 0.25);
    }
}
