//! Goals: position control of the root by keyframes, trajectories and obstacles.
//!
//! Positions are x and z in metres; frames are numbered from 0. A goal in TOML:
//!
//! ```toml
//! frames = 120            # length of the clip
//! margin = 0.1            # clearance around obstacles, metres
//!
//! [[keyframe]]
//! frame = 30
//! x = 0.5
//! z = 1.2
//!
//! [[obstacle]]
//! kind = "disc"
//! x = 1.0
//! z = 2.0
//! radius = 0.4
//!
//! [[obstacle]]
//! kind = "polygon"
//! vertices = [[2.0, 0.0], [3.0, 0.0], [2.5, 1.0]]
//! ```
//!
//! A trajectory, with one position per frame of a range, may replace the keyframes:
//!
//! ```toml
//! frames = 40
//!
//! [trajectory]
//! first_frame = 0
//! points = [[0.0, 0.0], [0.0, 0.05], [0.01, 0.1]]
//! ```

mod detour;
mod feasibility;
mod ground_targets;
mod guidance;
mod obstacle;
mod polygon;
mod schedule;

pub use ground_targets::{GROUND_X, GroundTargets, TRAJECTORY_CHANNELS};
pub use guidance::{GuidanceConfig, GuidanceLoss, GuidanceNorm};
pub use obstacle::Obstacle;
pub use schedule::{GuidanceSchedule, Phase};

use std::collections::HashMap;

use kinegrad_settings::{Document, DocumentError, InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::MAX_FRAMES;

/// The hint of errors about files of goals.
const HINT: &str = "docs/goals.md describes goals";

/// Furthest position from the origin along each axis, metres.
const MAX_METRES: f64 = 1e5;

/// Most corners of a goal's polygons, which are checked by pairs of edges.
const MOST_CORNERS: usize = 2000;

/// Most discs of a goal, which are checked in each frame.
const MOST_DISCS: usize = 1000;

/// Largest weight.
const MAX_WEIGHT: f64 = 1e9;

/// Rejects coordinates out of range.
fn check_metres(key: &str, metres: f64) -> Result<(), InvalidSetting> {
    in_range(key, metres, -MAX_METRES..=MAX_METRES)
        .hint("metres on the ground, x to the left of the first frame's body and z ahead of it")
}

/// [`check_metres`] of both coordinates of the position at `key`.
fn check_position(key: &str, [x, z]: [f64; 2]) -> Result<(), InvalidSetting> {
    check_metres("x", x).within(key)?;
    check_metres("z", z).within(key)
}

/// A target position of the root in one frame.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Keyframe {
    /// The frame, counted from 0.
    pub frame: usize,
    /// Ground position, metres.
    pub x: f64,
    /// Ground position, metres.
    pub z: f64,
}

impl Keyframe {
    /// The ground position `[x, z]`.
    pub fn position(&self) -> [f64; 2] {
        [self.x, self.z]
    }
}

/// Target positions of the root in a range of frames.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trajectory {
    /// Frame of the first point, counted from 0.
    #[serde(default)]
    pub first_frame: usize,
    /// Ground positions `[x, z]` from this frame on, one per frame, metres.
    pub points: Vec<[f64; 2]>,
}

/// Weights of the parts of a goal in the [`GuidanceLoss`].
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GoalWeights {
    /// Distance from keyframes or trajectory.
    pub position: f64,
    /// Depth in obstacles.
    pub obstacle: f64,
}

impl Default for GoalWeights {
    /// The published weights.
    fn default() -> Self {
        Self {
            position: 1.0,
            obstacle: 5.0,
        }
    }
}

/// Position control of one clip.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Length of the clip.
    pub frames: usize,
    /// Clearance around obstacles, metres.
    #[serde(default)]
    pub margin: f64,
    /// Keyframes in any order, at most one for each frame.
    #[serde(default, rename = "keyframe", skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<Keyframe>,
    /// A trajectory instead of keyframes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Trajectory>,
    /// Obstacles to avoid.
    #[serde(default, rename = "obstacle", skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<Obstacle>,
    /// Weights of the parts.
    #[serde(default)]
    pub weights: GoalWeights,
}

impl Goal {
    /// An empty goal for a clip of `frames` frames.
    pub fn new(frames: usize) -> Self {
        Self {
            frames,
            ..Self::default()
        }
    }

    /// The goal in the TOML `text` of `file`.
    ///
    /// # Errors
    /// Names the line, the key, the value found and the allowed values.
    pub fn parse(text: &str, file: &str) -> Result<Self, DocumentError> {
        let document = Document::parse(text, file)?;
        let goal: Self = document.read(HINT)?;
        goal.validate()
            .map_err(|setting| document.refuse(setting))?;
        Ok(goal)
    }

    /// # Errors
    /// Errors for goals that are outside the clip, contradictory, not finite, or empty. The error
    /// names the first invalid value, such as `keyframe[2].frame`.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("frames", self.frames, 1..=MAX_FRAMES)
            .hint("`frames` is the length of the clip")?;
        for (key, number, most) in [
            ("margin", self.margin, MAX_METRES),
            ("weights.position", self.weights.position, MAX_WEIGHT),
            ("weights.obstacle", self.weights.obstacle, MAX_WEIGHT),
        ] {
            in_range(key, number, 0.0..=most).hint("leave out the key for its default")?;
        }
        self.check_keyframes()?;
        if let Some(trajectory) = &self.trajectory {
            self.check_trajectory(trajectory)?;
        }
        let corners = self.obstacles.iter().map(Obstacle::corners).sum::<usize>();
        let found = format!("a list of polygons with {corners} corners in all");
        let allowed = format!("at most {MOST_CORNERS} corners");
        require(corners <= MOST_CORNERS, "obstacle", found, allowed)
            .hint("leave out corners that lie near the line between their neighbors")?;
        let discs = self.obstacles.iter();
        let discs = discs.filter(|obstacle| matches!(obstacle, Obstacle::Disc { .. }));
        let (discs, allowed) = (discs.count(), format!("at most {MOST_DISCS} discs"));
        let found = format!("a list of {discs} discs");
        require(discs <= MOST_DISCS, "obstacle", found, allowed)
            .hint("a polygon stands for many discs")?;
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            obstacle.validate().within(&format!("obstacle[{index}]"))?;
        }
        let empty =
            self.keyframes.is_empty() && self.trajectory.is_none() && self.obstacles.is_empty();
        let allowed = "keyframes, a trajectory or obstacles";
        require(!empty, "goal", "empty", allowed)
            .hint("add a `[[keyframe]]`, a `[trajectory]` or an `[[obstacle]]`")
    }

    fn check_keyframes(&self) -> Result<(), InvalidSetting> {
        let mut places = HashMap::new();
        for (index, keyframe) in self.keyframes.iter().enumerate() {
            let key = format!("keyframe[{index}]");
            self.check_frame(&format!("{key}.frame"), keyframe.frame)?;
            if let Some(earlier) = places.insert(keyframe.frame, index) {
                let found = format!("{}, like that of `keyframe[{earlier}]`", keyframe.frame);
                let allowed = "one keyframe for each frame";
                let refused = InvalidSetting::new(format!("{key}.frame"), found, allowed);
                return Err(refused.hint("leave out one of the two"));
            }
            check_position(&key, keyframe.position())?;
        }
        Ok(())
    }

    fn check_trajectory(&self, trajectory: &Trajectory) -> Result<(), InvalidSetting> {
        let keyframes = self.keyframes.len();
        let found = format!("given together with {keyframes} keyframes");
        require(keyframes == 0, "trajectory", found, "one of the two")
            .hint("write the keyframes into the trajectory, or leave the trajectory out")?;
        let points = &trajectory.points;
        let allowed = "one or more positions `[x, z]`";
        require(!points.is_empty(), "trajectory.points", "empty", allowed)
            .hint("leave out `[trajectory]` if there is none")?;
        self.check_frame("trajectory.first_frame", trajectory.first_frame)?;
        let (first, frames) = (trajectory.first_frame, self.frames);
        let found = format!("a list of {} positions", points.len());
        let longest = frames - first;
        let allowed = format!("at most {longest} (from frame {first} of {frames})");
        require(points.len() <= longest, "trajectory.points", found, allowed)
            .hint("give one position for each frame, or raise `frames`")?;
        for (index, &point) in points.iter().enumerate() {
            check_position(&format!("trajectory.points[{index}]"), point)?;
        }
        Ok(())
    }

    /// Rejects a frame after the clip's end.
    fn check_frame(&self, key: &str, frame: usize) -> Result<(), InvalidSetting> {
        let frames = self.frames;
        let allowed = format!("0 to {} (the goal has {frames} frames)", frames - 1);
        require(frame < frames, key, frame, allowed)
            .hint("frames count from 0; raise `frames` for a longer clip")
    }

    /// The target positions: the keyframes, or the trajectory.
    pub fn points(&self) -> GroundTargets {
        match &self.trajectory {
            Some(all) => GroundTargets::trajectory(&all.points, all.first_frame, self.frames),
            None => GroundTargets::points(&self.keyframes, self.frames),
        }
    }

    /// The positions that are imputed in early sampling steps: the trajectory, or the keyframes
    /// with the [line between them](GroundTargets::point_to_point). A goal with obstacles imputes
    /// only the keyframes, because the line could cross an obstacle (GMD, appendix F).
    pub fn dense(&self) -> GroundTargets {
        if self.trajectory.is_some() || !self.obstacles.is_empty() {
            return self.points();
        }
        GroundTargets::point_to_point(&self.keyframes, self.frames)
    }

    /// The positions that the published program uses in a phase of the sampler.
    pub fn targets(&self, phase: Phase) -> Option<GroundTargets> {
        match phase {
            Phase::Dense => Some(self.dense()),
            Phase::Points => Some(self.points()),
            Phase::Off => None,
        }
    }
}

#[cfg(test)]
mod tests;
