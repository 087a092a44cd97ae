//! What a user asks the motion's root to do: where to be when, and what to keep out of.
//!
//! Positions lie on the ground, x and z in metres; frames count from 0. A goal is read from a
//! document such as this:
//!
//! ```toml
//! frames = 120            # length of the clip
//! margin = 0.1            # metres kept free around obstacles
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
//! Instead of key frames it may hold a trajectory, a position for each frame of a range:
//!
//! ```toml
//! frames = 40
//!
//! [trajectory]
//! first_frame = 0
//! points = [[0.0, 0.0], [0.0, 0.05], [0.01, 0.1]]
//! ```

mod guidance;
mod obstacle;
mod polygon;
mod schedule;
mod targets;

pub use guidance::{GuidanceConfig, GuidanceLoss, GuidanceNorm};
pub use obstacle::Obstacle;
pub use schedule::{GuidanceSchedule, Phase};
pub use targets::{GROUND_X, GroundTargets, TRAJECTORY_CHANNELS};

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use serde::{Deserialize, Serialize};

/// Refuses a coordinate that is not finite.
fn check_metres(key: &str, metres: f64) -> Result<(), InvalidSetting> {
    require(metres.is_finite(), key, metres, "a finite number of metres").hint(
        "positions lie on the ground, x to the left of the first frame's body and z ahead of it",
    )
}

/// [`check_metres`] of both coordinates of the position at `key`.
fn check_position(key: &str, [x, z]: [f64; 2]) -> Result<(), InvalidSetting> {
    check_metres("x", x).within(key)?;
    check_metres("z", z).within(key)
}

/// Where the root shall be in one frame.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
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

/// Where the root shall be in each frame of a range.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Trajectory {
    /// Frame of the first point, counted from 0.
    #[serde(default)]
    pub first_frame: usize,
    /// Ground positions `[x, z]` of this frame and those after it, metres.
    pub points: Vec<[f64; 2]>,
}

/// How much the parts of a goal count in the [`GuidanceLoss`].
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct GoalWeights {
    /// Distance from key frames or trajectory.
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

/// What one clip's root shall do.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Length of the clip.
    pub frames: usize,
    /// Metres that the root shall keep away from obstacles.
    #[serde(default)]
    pub margin: f64,
    /// Key frames in any order, at most one for each frame. In a document `[[keyframe]]`.
    #[serde(default, rename = "keyframe", skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<Keyframe>,
    /// A trajectory instead of key frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Trajectory>,
    /// What to keep out of. In a document `[[obstacle]]`.
    #[serde(default, rename = "obstacle", skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<Obstacle>,
    /// How much each part counts.
    #[serde(default)]
    pub weights: GoalWeights,
}

impl Goal {
    /// A clip of `frames` frames that nothing is asked of yet.
    pub fn new(frames: usize) -> Self {
        Self {
            frames,
            margin: 0.0,
            keyframes: Vec::new(),
            trajectory: None,
            obstacles: Vec::new(),
            weights: GoalWeights::default(),
        }
    }

    /// Refuses a goal that cannot be followed: outside of the clip, contradictory, not finite, or
    /// empty. What it accepts no other function here stumbles over.
    ///
    /// # Errors
    /// Names the first such value by its place, such as `keyframe[2].frame`; lists count from 0.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("frames", self.frames, 1..).hint("`frames` is the length of the clip")?;
        for (key, number) in [
            ("margin", self.margin),
            ("weights.position", self.weights.position),
            ("weights.obstacle", self.weights.obstacle),
        ] {
            in_range(key, number, 0.0..).hint("leave out the key for its default")?;
        }
        self.check_keyframes()?;
        if let Some(trajectory) = &self.trajectory {
            self.check_trajectory(trajectory)?;
        }
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            obstacle.validate().within(&format!("obstacle[{index}]"))?;
        }
        let empty =
            self.keyframes.is_empty() && self.trajectory.is_none() && self.obstacles.is_empty();
        let allowed = "key frames, a trajectory or obstacles";
        require(!empty, "goal", "empty", allowed)
            .hint("add a `[[keyframe]]`, a `[trajectory]` or an `[[obstacle]]`")
    }

    fn check_keyframes(&self) -> Result<(), InvalidSetting> {
        for (index, keyframe) in self.keyframes.iter().enumerate() {
            let key = format!("keyframe[{index}]");
            self.check_frame(&format!("{key}.frame"), keyframe.frame)?;
            let same = |other: &Keyframe| other.frame == keyframe.frame;
            if let Some(earlier) = self.keyframes[..index].iter().position(same) {
                let found = format!("{}, like that of `keyframe[{earlier}]`", keyframe.frame);
                let allowed = "one key frame for each frame";
                let refused = InvalidSetting::new(format!("{key}.frame"), found, allowed);
                return Err(refused.hint("leave out one of the two"));
            }
            check_position(&key, keyframe.position())?;
        }
        Ok(())
    }

    fn check_trajectory(&self, trajectory: &Trajectory) -> Result<(), InvalidSetting> {
        require(
            self.keyframes.is_empty(),
            "trajectory",
            format!("given beside {} key frames", self.keyframes.len()),
            "one of the two",
        )
        .hint("write the key frames into the trajectory, or leave the trajectory out")?;
        let points = &trajectory.points;
        let allowed = "one or more positions `[x, z]`";
        require(!points.is_empty(), "trajectory.points", "empty", allowed)
            .hint("leave out `[trajectory]` if there is none")?;
        self.check_frame("trajectory.first_frame", trajectory.first_frame)?;
        let longest = self.frames - trajectory.first_frame;
        require(
            points.len() <= longest,
            "trajectory.points",
            format!("a list of {} positions", points.len()),
            format!(
                "at most {longest} (from frame {} of {})",
                trajectory.first_frame, self.frames
            ),
        )
        .hint("give one position for each frame, or raise `frames`")?;
        for (index, &point) in points.iter().enumerate() {
            check_position(&format!("trajectory.points[{index}]"), point)?;
        }
        Ok(())
    }

    /// Refuses a frame after the clip's end.
    fn check_frame(&self, key: &str, frame: usize) -> Result<(), InvalidSetting> {
        let frames = self.frames;
        let allowed = format!("0 to {} (the goal has {frames} frames)", frames - 1);
        require(frame < frames, key, frame, allowed)
            .hint("frames count from 0; raise `frames` for a longer clip")
    }

    /// The positions that are asked for: the key frames, or the trajectory.
    ///
    /// # Panics
    /// Panics if [`validate`](Self::validate) would refuse a frame.
    pub fn points(&self) -> GroundTargets {
        match &self.trajectory {
            Some(Trajectory {
                first_frame,
                points,
            }) => GroundTargets::trajectory(points, *first_frame, self.frames),
            None => GroundTargets::points(&self.keyframes, self.frames),
        }
    }

    /// The positions that are put into an early step of a sampler: the trajectory, or the key frames with
    /// the [line between them](GroundTargets::point_to_point), but the key frames alone where there
    /// are obstacles, through which the line might lead (GMD, appendix F).
    ///
    /// # Panics
    /// Panics if [`validate`](Self::validate) would refuse a frame.
    pub fn dense(&self) -> GroundTargets {
        if self.trajectory.is_some() || !self.obstacles.is_empty() {
            return self.points();
        }
        GroundTargets::point_to_point(&self.keyframes, self.frames)
    }

    /// The positions that act in a phase of the sampler, `None` where none do.
    ///
    /// # Panics
    /// Panics if [`validate`](Self::validate) would refuse a frame.
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
