//! Goals taken from held-out clips.

use kinegrad_data::humanml::Clip;
use kinegrad_motion::goal::{Goal, Keyframe, Obstacle};
use kinegrad_random::{Key, Purpose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Radius of the obstacles, metres: a person with some room.
const OBSTACLE_RADIUS: f64 = 0.35;

/// Distance of an obstacle's edge from where the way begins and ends, metres.
const CLEARANCE: f64 = 0.1;

/// Which frames are keyframes.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KeyframePlacement {
    /// Frames drawn at random, as in the published evaluation; of a frame that is drawn twice,
    /// one.
    #[default]
    Random,
    /// Evenly spaced frames, the last one of the clip among them.
    Even,
}

/// How a goal is derived from a held-out clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GoalTask {
    /// Number of keyframes.
    pub keyframes: usize,
    /// Which frames they are.
    pub keyframe_placement: KeyframePlacement,
    /// Number of discs of 35 cm on the path, evenly spaced in time; those that would cover its
    /// start or end are left out. With obstacles, only the last frame is a keyframe.
    pub obstacles: usize,
    /// Maximum number of frames.
    pub frames: usize,
}

impl GoalTask {
    /// The goal derived from `clip`; `seed` draws its keyframes, with the clip's id.
    pub fn goal(&self, clip: &Clip, seed: u64) -> Goal {
        let frames = clip.features.frames().min(self.frames);
        let features = clip.features.slice(0..frames).to_absolute();
        let path = features.root_positions();
        let last = frames - 1;
        let mut goal = Goal::new(frames);
        let keyframe = |frame: usize| {
            let [x, _, z] = path[frame];
            Keyframe { frame, x, z }
        };
        if self.obstacles == 0 {
            let mut places: Vec<usize> = match self.keyframe_placement {
                KeyframePlacement::Random => Key::new(seed, Purpose::GoalFrames)
                    .named(&clip.id)
                    .integers(self.keyframes, frames),
                KeyframePlacement::Even => {
                    let parts = self.keyframes.max(1);
                    (1..=self.keyframes).map(|k| k * last / parts).collect()
                }
            };
            places.sort_unstable();
            places.dedup();
            goal.keyframes = places.into_iter().map(keyframe).collect();
            return goal;
        }
        goal.keyframes = vec![keyframe(last)];
        let ends = [path[0], path[last]];
        let clear = |[x, _, z]: &[f64; 3]| {
            let far = |[ex, _, ez]: &[f64; 3]| (x - ex).hypot(z - ez) > OBSTACLE_RADIUS + CLEARANCE;
            ends.iter().all(far)
        };
        goal.obstacles = (1..=self.obstacles)
            .map(|k| path[k * last / (self.obstacles + 1)])
            .filter(clear)
            .map(|[x, _, z]| Obstacle::Disc {
                x,
                z,
                radius: OBSTACLE_RADIUS,
            })
            .collect();
        goal
    }
}
