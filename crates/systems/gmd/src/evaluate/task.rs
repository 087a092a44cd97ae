//! Goals taken from held-out clips.

use kinegrad_data::humanml::Clip;
use kinegrad_motion::goal::{Goal, Keyframe, Obstacle};
use kinegrad_random::{Key, Purpose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Radius of the obstacles, meters: a person with some clearance.
const OBSTACLE_RADIUS: f64 = 0.35;

/// Least distance of an obstacle's edge from both ends of the path, meters, unless the margin is
/// larger.
const CLEARANCE: f64 = 0.1;

/// The choice of keyframes.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KeyframePlacement {
    /// Random frames, as in the published evaluation; frames sampled twice count once.
    #[default]
    Random,
    /// Evenly spaced frames, including the last frame of the clip.
    Even,
}

/// The derivation of a goal from a held-out clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct GoalTask {
    pub keyframes: usize,
    pub keyframe_placement: KeyframePlacement,
    /// Number of discs with radius 35 cm on the path, evenly spaced in time. Discs that would cover
    /// the path's start or end are omitted. With obstacles, only the last frame is a keyframe.
    pub obstacles: usize,
    pub margin: f64,
    /// Maximum number of frames.
    pub frames: usize,
}

impl GoalTask {
    /// The goal derived from `clip`; its keyframes depend on `seed` and the clip's id.
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
                    let parts = self.keyframes;
                    (1..=parts).map(|k| k * last / parts).collect()
                }
            };
            places.sort_unstable();
            places.dedup();
            goal.keyframes = places.into_iter().map(keyframe).collect();
            return goal;
        }
        goal.keyframes = vec![keyframe(last)];
        goal.margin = self.margin;
        let ends = [path[0], path[last]];
        let clear = |[x, _, z]: &[f64; 3]| {
            let least = OBSTACLE_RADIUS + CLEARANCE.max(self.margin);
            let far = |[ex, _, ez]: &[f64; 3]| (x - ex).hypot(z - ez) > least;
            ends.iter().all(far)
        };
        let disc = |[x, _, z]: [f64; 3]| Obstacle::Disc {
            x,
            z,
            radius: OBSTACLE_RADIUS,
        };
        let places = (1..=self.obstacles).map(|k| path[k * last / (self.obstacles + 1)]);
        goal.obstacles = places.filter(clear).map(disc).collect();
        goal
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::humanml::{FeatureLayout, Features, Root};

    use super::*;

    const FRAMES: usize = 80;

    /// A straight path of 4 cm per frame.
    fn clip(id: &str) -> Clip {
        let layout = FeatureLayout::of_joints(22).unwrap();
        let mut values = vec![0.0; FRAMES * layout.channels()];
        let frames = values.chunks_exact_mut(layout.channels());
        frames.for_each(|frame| frame[2] = 0.04);
        Clip {
            id: id.to_owned(),
            features: Features::new(values, layout, Root::Relative).unwrap(),
            captions: Vec::new(),
        }
    }

    const TASK: GoalTask = GoalTask {
        keyframes: 5,
        keyframe_placement: KeyframePlacement::Random,
        obstacles: 0,
        margin: 0.2,
        frames: 60,
    };

    fn places(goal: &Goal) -> Vec<usize> {
        goal.keyframes.iter().map(|each| each.frame).collect()
    }

    #[test]
    fn keyframes_are_sampled_from_all_frames() {
        let of = |id: &str, seed| places(&TASK.goal(&clip(id), seed));
        assert_eq!(of("a", 1), of("a", 1));
        assert_ne!(of("a", 1), of("b", 1));
        assert_ne!(of("a", 1), of("a", 2));
        // Over many seeds, the keyframes are exactly the frames of the goal.
        let mut counts = [0; 60];
        for seed in 0..400 {
            let found = of("a", seed);
            assert!(found.is_sorted_by(|a, b| a < b), "{found:?}");
            found.iter().for_each(|&frame| counts[frame] += 1);
        }
        assert!(counts.iter().all(|&count| count > 10), "{counts:?}");
        let even = GoalTask {
            keyframe_placement: KeyframePlacement::Even,
            ..TASK
        };
        for seed in 0..3 {
            assert_eq!(places(&even.goal(&clip("a"), seed)), [11, 23, 35, 47, 59]);
        }
    }

    #[test]
    fn obstacles_stand_on_the_path_with_the_margin_of_guidance() {
        let task = GoalTask {
            obstacles: 2,
            ..TASK
        };
        let goal = task.goal(&clip("a"), 1);
        assert_eq!(places(&goal), [59]);
        assert_eq!(goal.margin, 0.2);
        assert_eq!(goal.obstacles.len(), 2);
        for (obstacle, frame) in goal.obstacles.iter().zip([19.0, 39.0]) {
            let depth = obstacle.signed_distance([0.0, 0.04 * frame]);
            assert!((depth + OBSTACLE_RADIUS).abs() < 1e-5, "{depth}");
        }
        // 76 and 80 cm from the ends of the path.
        let wide = GoalTask {
            margin: 0.42,
            ..task
        };
        assert_eq!(wide.goal(&clip("a"), 1).obstacles.len(), 1);
        let wide = GoalTask {
            margin: 0.46,
            ..task
        };
        assert_eq!(wide.goal(&clip("a"), 1).obstacles.len(), 0);
    }
}
