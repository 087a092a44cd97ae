//! Warping of a motion onto a path (docs/sources.md, section 7, option A).

use serde::{Deserialize, Serialize};

use super::course::{ground, walked};
use super::idle::standing_after;
use super::{
    ArcLengthMode, Course, Edges, HEADING_ORDER, HEADING_WINDOW, PathError, Polyline, STILL,
    headings_of, headings_of_gait, savgol, unwrapped,
};
use crate::humanml::bone_rotations::{Across, forward};
use crate::humanml::{FeatureError, Joints, Skeleton};

/// Heading of a body on its path.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadingMode {
    /// Rotated like the direction of the trajectory: a sideways walk stays sideways.
    #[default]
    Relative,
    /// In the direction of the path.
    Face,
    /// Unchanged.
    Free,
}

/// Settings of the warp of a motion onto a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Warp {
    /// Arc length of each frame.
    pub along: ArcLengthMode,
    /// Mean speed of the motion along the path, metres per second, instead of [`Stretch`]. At the
    /// end of the path the motion stands.
    ///
    /// [`Stretch`]: ArcLengthMode::Stretch
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
    /// Heading of the body.
    pub turning: HeadingMode,
    /// Smooth rotations with a Savitzky-Golay filter of 11 frames and order 3.
    pub smooth: bool,
    /// Smallest speed of a root with a direction, metres per second, for relative headings. The
    /// body then does not follow the sway of standing. At 0 every step has a direction.
    pub least_speed: f64,
}

impl Warp {
    /// Speed below which a person stands, metres per second.
    pub const STANDING: f64 = 0.15;
}

/// A motion on a path.
#[derive(Clone, Debug)]
pub struct Warped {
    /// The joints.
    pub joints: Joints,
    /// The joints before the move, frame by frame: the motion, with the frames in which it stands.
    pub own: Joints,
    /// The first frame that stands at the end of the path.
    pub stands_from: Option<usize>,
    /// The course of the root.
    pub course: Course,
    /// Rotation of each frame about +y, radians.
    pub turned: Vec<f64>,
    /// Ratio of the trajectory's length on the path to the original length; 0 for a standing
    /// motion.
    pub speed_ratio: f64,
}

impl Warp {
    /// `joints` on `path`: each frame is moved and rotated about the vertical through the root.
    ///
    /// # Errors
    /// [`PathError::Features`] for joints of another skeleton.
    pub fn apply(
        &self,
        joints: &Joints,
        skeleton: &Skeleton,
        path: &Polyline,
    ) -> Result<Warped, PathError> {
        joints.must_be_of(skeleton)?;
        let pace = self.pace(joints, skeleton);
        let idle = match pace {
            Some(pace) => standing_after(joints, skeleton, path.length() / pace)?,
            None => None,
        };
        let stands_from = idle.as_ref().map(|idle| idle.from);
        let own = idle.map_or_else(|| joints.clone(), |idle| idle.joints);
        let track = ground(&own);
        let course = match pace {
            Some(pace) => Course::at_pace(path, &track, pace),
            None => Course::of_motion(path, &track, ArcLengthMode::Stretch),
        };
        let turned = match path.length() < STILL {
            true => vec![0.0; track.len()],
            false => self.turns(&own, skeleton, &track, &course),
        };
        let last = |metres: &[f64]| metres.last().copied().unwrap_or(0.0);
        let (before, after) = (last(&walked(&track)), last(&course.metres));
        Ok(Warped {
            joints: placed(&own, &course.points, &turned)?,
            own,
            stands_from,
            course,
            turned,
            speed_ratio: if before < STILL { 0.0 } else { after / before },
        })
    }

    /// Ratio of the arc lengths on the path to those of the motion, if the path does not determine
    /// it.
    fn pace(&self, joints: &Joints, skeleton: &Skeleton) -> Option<f64> {
        match (self.along, self.speed) {
            (ArcLengthMode::Own, _) => Some(1.0),
            (ArcLengthMode::Stretch, None) => None,
            (ArcLengthMode::Stretch, Some(speed)) => {
                let walked = walked(&ground(joints)).last().copied().unwrap_or(0.0);
                let seconds = (joints.frames() - 1) as f64 / skeleton.description().fps;
                (walked >= STILL && seconds > 0.0).then(|| speed * seconds / walked)
            }
        }
    }

    /// Rotation about +y of each frame of `joints` on a course, radians; the root is at `track`.
    pub fn turns(
        &self,
        joints: &Joints,
        skeleton: &Skeleton,
        track: &[[f64; 2]],
        course: &Course,
    ) -> Vec<f64> {
        let own = match self.turning {
            HeadingMode::Free => return vec![0.0; track.len()],
            HeadingMode::Relative if self.least_speed > 0.0 => {
                headings_of_gait(track, self.least_speed / skeleton.description().fps)
            }
            HeadingMode::Relative => headings_of(track),
            HeadingMode::Face => facing(joints, skeleton)[..track.len()].to_vec(),
        };
        let path = unwrapped(&headings_of(&course.points));
        let both = path.iter().zip(unwrapped(&own));
        let turns: Vec<f64> = both.map(|(path, own)| path - own).collect();
        match self.smooth {
            true => savgol(&turns, HEADING_WINDOW, HEADING_ORDER, Edges::Fitted),
            false => turns,
        }
    }
}

/// `joints` with each frame rotated by `turns` about the vertical through the root. The root is
/// moved to `points`. Frames after the last point are dropped.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] for different numbers of angles and points, or too few frames.
pub fn placed(joints: &Joints, points: &[[f64; 2]], turns: &[f64]) -> Result<Joints, FeatureError> {
    FeatureError::unless_equal("angles", points.len(), turns.len())?;
    FeatureError::unless_equal("points", points.len().min(joints.frames()), points.len())?;
    let mut places = Vec::with_capacity(points.len() * joints.joints());
    for (t, ([x, z], turn)) in points.iter().zip(turns).enumerate() {
        let frame = joints.frame(t);
        let (root, (sin, cos)) = (frame[0], turn.sin_cos());
        places.extend(frame.iter().map(|[jx, y, jz]| {
            let (dx, dz) = (jx - root[0], jz - root[2]);
            [x + dx * cos + dz * sin, *y, z - dx * sin + dz * cos]
        }));
    }
    Joints::new(places, joints.joints())
}

/// Heading of a body in each frame, radians.
pub(super) fn facing(joints: &Joints, skeleton: &Skeleton) -> Vec<f64> {
    let heading = |t: usize| {
        let [x, _, z] = forward(skeleton, joints.frame(t), Across::Consistent);
        x.atan2(z)
    };
    (0..joints.frames()).map(heading).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::humanml::walk::{Course as Walk, joints as walk};
    use crate::path::wrapped;
    use crate::vector::{length, minus};

    fn walking(frames: usize) -> (Joints, Skeleton) {
        let skeleton = Skeleton::humanml3d();
        let course = Walk {
            speed: Box::new(|t| 1.0 + 0.3 * t.sin()),
            turning: Box::new(|t| 0.5 * (0.7 * t).cos()),
        };
        let places = walk(&course, &skeleton, frames);
        (Joints::new(places, 22).unwrap(), skeleton)
    }

    fn corner() -> Polyline {
        Polyline::new(vec![[1.0, -2.0], [1.0, 1.0], [-3.0, 1.0]]).unwrap()
    }

    #[test]
    fn the_root_is_on_the_path_and_bones_stay() {
        let (joints, skeleton) = walking(70);
        let path = corner();
        for turning in [HeadingMode::Relative, HeadingMode::Face, HeadingMode::Free] {
            for smooth in [false, true] {
                let warp = Warp {
                    turning,
                    smooth,
                    ..Warp::default()
                };
                let warped = warp.apply(&joints, &skeleton, &path).unwrap();
                let ends = [(0, [1.0, -2.0]), (69, [-3.0, 1.0])];
                for (t, [x, z]) in ends {
                    let root = warped.joints.frame(t)[0];
                    assert!((root[0] - x).abs() < 1e-9 && (root[2] - z).abs() < 1e-9);
                }
                for t in 0..70 {
                    let (old, new) = (joints.frame(t), warped.joints.frame(t));
                    for (joint, parent) in skeleton.parents().iter().enumerate() {
                        assert_eq!(old[joint][1], new[joint][1]);
                        let Some(parent) = *parent else { continue };
                        let bone = |frame: &[[f64; 3]]| length(minus(frame[joint], frame[parent]));
                        assert!((bone(old) - bone(new)).abs() < 1e-12);
                    }
                }
            }
        }
    }

    #[test]
    fn a_walk_faces_along_the_path_and_side_steps_stay_sideways() {
        let (joints, skeleton) = walking(70);
        let line = Polyline::new(vec![[0.0, 0.0], [-5.0, 0.0]]).unwrap();
        let facing_of = |joints: &Joints, warp: Warp| {
            let warped = warp.apply(joints, &skeleton, &line).unwrap();
            facing(&warped.joints, &skeleton)
        };
        let to_left = -PI / 2.0;
        for turning in [HeadingMode::Relative, HeadingMode::Face] {
            let warp = Warp {
                turning,
                ..Warp::default()
            };
            for heading in facing_of(&joints, warp) {
                assert!(
                    wrapped(heading - to_left).abs() < 0.15,
                    "{turning:?}: {heading}"
                );
            }
        }
        // The same body moves sideways: it faces +z and travels along +x.
        let sideways = (0..70).flat_map(|t| {
            let frame = joints.frame(0);
            let by = 0.05 * t as f64;
            frame.iter().map(move |[x, y, z]| [x + by, *y, *z])
        });
        let sideways = Joints::new(sideways.collect(), 22).unwrap();
        let before = facing(&sideways, &skeleton)[0] - PI / 2.0;
        for heading in facing_of(&sideways, Warp::default()) {
            assert!(wrapped(heading - to_left - before).abs() < 1e-6);
        }
        let face = Warp {
            turning: HeadingMode::Face,
            ..Warp::default()
        };
        assert!(wrapped(facing_of(&sideways, face)[30] - to_left).abs() < 1e-6);
    }

    #[test]
    fn a_body_that_stands_and_sways_is_not_turned() {
        let (joints, skeleton) = walking(60);
        let still = joints.frame(0).to_vec();
        // The body stands for two seconds, swaying by millimetres, then walks.
        let mut places = Vec::new();
        for t in 0..40 {
            let (a, b) = (
                3e-3 * (0.9 * f64::from(t)).sin(),
                2e-3 * (1.3 * f64::from(t)).cos(),
            );
            places.extend(still.iter().map(|[x, y, z]| [x + a, *y, z + b]));
        }
        places.extend(joints.as_slice());
        let standing = Joints::new(places, 22).unwrap();
        let line = Polyline::new(vec![[0.0, 0.0], [5.0, 0.0]]).unwrap();
        let turned = |least_speed: f64| {
            let warp = Warp {
                smooth: true,
                least_speed,
                ..Warp::default()
            };
            let warped = warp.apply(&standing, &skeleton, &line).unwrap();
            let turns = warped.turned[..35].windows(2);
            turns.map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>()
        };
        assert!(turned(0.0) > 3.0, "{}", turned(0.0));
        assert!(turned(Warp::STANDING) < 0.2, "{}", turned(Warp::STANDING));
    }

    #[test]
    fn at_the_end_of_a_short_path_the_motion_stands() {
        let (joints, skeleton) = walking(70);
        let own = Warp {
            along: ArcLengthMode::Own,
            ..Warp::default()
        };
        let short = Polyline::new(vec![[0.0, 0.0], [1.0, 0.0]]).unwrap();
        let warped = own.apply(&joints, &skeleton, &short).unwrap();
        assert_eq!((warped.joints.frames(), warped.own.frames()), (70, 70));
        assert!((warped.speed_ratio - 1.0).abs() < 1e-12);
        let from = warped.stands_from.unwrap();
        assert!((20..40).contains(&from), "{from}");
        for t in from..70 {
            let [x, _, z] = warped.joints.frame(t)[0];
            assert!((x - 1.0).abs() < 0.01 && z.abs() < 1e-9, "{t}: {x} {z}");
            for (a, b) in warped.joints.frame(t).iter().zip(warped.joints.frame(69)) {
                assert!(length(minus(*a, *b)) < 1e-9, "{t}");
            }
        }
        let stretched = Warp::default().apply(&joints, &skeleton, &short).unwrap();
        assert_eq!(stretched.joints.frames(), 70);
        assert!(stretched.speed_ratio < 0.5 && stretched.stands_from.is_none());
        let other = Skeleton::kit();
        assert!(own.apply(&joints, &other, &short).is_err());
    }

    #[test]
    fn a_stated_speed_is_the_mean_speed_until_the_motion_stands() {
        let (joints, skeleton) = walking(70);
        let line = |metres| Polyline::new(vec![[0.0, 0.0], [0.0, metres]]).unwrap();
        let at = |speed, metres| {
            let warp = Warp {
                speed: Some(speed),
                ..Warp::default()
            };
            warp.apply(&joints, &skeleton, &line(metres)).unwrap()
        };
        let far = at(0.8, 20.0);
        let seconds = 69.0 / 20.0;
        let end = far.joints.frame(69)[0][2];
        assert!((end - 0.8 * seconds).abs() < 1e-9 && far.stands_from.is_none());
        let slow = at(0.8, 1.0);
        let from = slow.stands_from.unwrap();
        // 1 m takes 1.25 s, and half a second more to slow down.
        assert!((30..45).contains(&from), "{from}");
        assert!((slow.joints.frame(69)[0][2] - 1.0).abs() < 0.01);
        assert!((slow.speed_ratio - far.speed_ratio).abs() < 1e-9);
        assert!(at(1.2, 1.0).stands_from.unwrap() < from);
    }
}
