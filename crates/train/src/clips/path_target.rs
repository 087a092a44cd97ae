//! Paths that generated motion follows (docs/sources.md, section 7).
//!
//! A path is moved to the origin, with heading +z, for sampling. The motion is moved to the path
//! afterwards.

use std::path::{Path, PathBuf};

use kinegrad_data::file::read_text;
use kinegrad_motion::Statistics;
use kinegrad_motion::feet::{ContactRule, Planted, lock_joints};
use kinegrad_motion::humanml::{Extraction, Features, Joints, Root, Skeleton};
use kinegrad_motion::path::{
    ArcLengthMode, Course, Edges, HEADING_ORDER, HEADING_WINDOW, HeadingMode, PathError, PathPlan,
    PathReport, Polyline, Warp, headings_of, placed, savgol, smoothed, unwrapped,
};

use serde_json::Value;

use crate::error::Error;
use crate::sampling::{PathFile, PathRecord};

/// The target positions of a motion.
#[derive(Clone, Debug)]
pub struct PathTarget {
    /// The path.
    pub line: Polyline,
    /// The position on the path in each frame.
    pub course: Course,
    /// The heading in each frame, smoothed and unwrapped, radians.
    pub headings: Vec<f64>,
}

impl PathTarget {
    /// Bodies turn with the heading of their root trajectory; sway does not turn a standing body.
    const WARP: Warp = Warp {
        along: ArcLengthMode::Stretch,
        speed: None,
        turning: HeadingMode::Relative,
        smooth: true,
        least_speed: Warp::STANDING,
    };

    /// The target of a plan for `frames` frames at `fps` frames per second.
    ///
    /// # Errors
    /// If the plan is not a path.
    pub fn new(plan: &PathPlan, frames: usize, fps: f64) -> Result<Self, Error> {
        let unusable = |error: &dyn std::fmt::Display| {
            let message = format!("the path cannot be followed: {error}");
            Error::usage(message, "docs/paths.md")
        };
        plan.validate().map_err(|error| unusable(&error))?;
        let line = plan.polyline().map_err(|error| unusable(&error))?;
        let course = Course::at_speed(&line, frames, plan.speed, fps);
        Ok(Self::of(line, course))
    }

    /// The target at `points`, one for each frame.
    ///
    /// # Errors
    /// [`PathError`] for fewer than two points.
    pub fn through(points: Vec<[f64; 2]>) -> Result<Self, PathError> {
        let line = Polyline::new(points.clone())?;
        Ok(Self::of(line, Course::through(points)))
    }

    fn of(line: Polyline, course: Course) -> Self {
        let headings = unwrapped(&headings_of(&course.points));
        let headings = savgol(&headings, HEADING_WINDOW, HEADING_ORDER, Edges::Fitted);
        Self {
            line,
            course,
            headings,
        }
    }

    /// The warning about a path in `file` that is faster than the training motion.
    pub fn too_fast(&self, file: &Path, fps: f64, fastest: Fastest) -> Option<String> {
        let steps = self.course.metres.windows(2).map(|pair| pair[1] - pair[0]);
        let speed = steps.fold(0.0, f64::max) * fps;
        let (limit, of) = match fastest {
            Fastest::Measured(limit) => (limit, "any motion of training"),
            Fastest::Estimated(limit) => (limit, "five deviations from the mean of training"),
        };
        (speed > limit).then(|| {
            format!(
                "{} asks for {speed:.2} m/s, {:.2} m/s more than {of}: give the motion more time, or \
                 a shorter path",
                file.display(),
                speed - limit
            )
        })
    }

    /// The target moved to the origin and facing +z, for sampling.
    #[must_use]
    pub fn at_origin(&self) -> Self {
        let (start, turn) = (self.course.points[0], -self.headings[0]);
        let (sin, cos) = turn.sin_cos();
        let moved = |[x, z]: &[f64; 2]| {
            let (dx, dz) = (x - start[0], z - start[1]);
            [dx * cos + dz * sin, dz * cos - dx * sin]
        };
        let points: Vec<[f64; 2]> = self.course.points.iter().map(moved).collect();
        Self {
            line: self.line.clone(),
            course: Course {
                metres: self.course.metres.clone(),
                points,
            },
            headings: self.headings.iter().map(|heading| heading + turn).collect(),
        }
    }

    /// Moves ground positions that are relative to the path's start onto the path.
    pub fn on_path(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let ([x0, z0], (sin, cos)) = (self.course.points[0], self.headings[0].sin_cos());
        let moved = |[x, z]: &[f64; 2]| [x0 + x * cos + z * sin, z0 - x * sin + z * cos];
        points.iter().map(moved).collect()
    }

    /// Moves a motion that was sampled in the path's frame onto the path.
    ///
    /// # Errors
    /// If the motion does not fit the skeleton.
    pub fn placed(&self, joints: &Joints, skeleton: &Skeleton) -> Result<Followed, Error> {
        let track: Vec<[f64; 2]> = joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
        let turns = vec![self.headings[0]; track.len()];
        let joints = placed(joints, &self.on_path(&track), &turns)?;
        self.measured(joints, skeleton, 0.0)
    }

    /// Moves a motion near the path onto the path frame by frame, at the pace of the course. The
    /// body turns with the heading of its root trajectory. Feet are locked if `lock_feet` is true.
    ///
    /// # Errors
    /// If the motion does not fit the skeleton.
    pub fn corrected(
        &self,
        joints: &Joints,
        skeleton: &Skeleton,
        lock_feet: bool,
    ) -> Result<Followed, Error> {
        let fps = skeleton.description().fps;
        let root = joints.track(0);
        let track: Vec<[f64; 2]> = root.iter().map(|[x, _, z]| [*x, *z]).collect();
        let turns = Self::WARP.turns(joints, skeleton, &track, &self.course);
        // A body sways with its steps, so the smoothed trajectory is moved onto the path.
        let trajectory = root_trajectory(&root, fps);
        let moved = track
            .iter()
            .zip(&trajectory)
            .zip(&self.course.points)
            .zip(&turns);
        let moved = moved.map(|(((place, smooth), to), turn)| {
            let [dx, dz] = [0, 1].map(|axis| place[axis] - smooth[axis]);
            let (sin, cos) = turn.sin_cos();
            [to[0] + dx * cos + dz * sin, to[1] - dx * sin + dz * cos]
        });
        let moved: Vec<[f64; 2]> = moved.collect();
        let moved = placed(joints, &moved, &turns)?;
        self.with_feet(moved, joints, skeleton, lock_feet)
    }

    fn measured(
        &self,
        joints: Joints,
        skeleton: &Skeleton,
        legs_short: f64,
    ) -> Result<Followed, Error> {
        let report = PathReport::of(&joints, skeleton, &self.line, &self.course, 0.0)?;
        Ok(Followed {
            joints,
            report,
            legs_short,
            cut: None,
        })
    }

    /// `moved` with the feet of `before` locked, if requested, and its deviation from the path.
    fn with_feet(
        &self,
        moved: Joints,
        before: &Joints,
        skeleton: &Skeleton,
        lock_feet: bool,
    ) -> Result<Followed, Error> {
        let (joints, legs_short) = match lock_feet {
            true => {
                let locked = lock_joints(
                    &moved,
                    before,
                    skeleton,
                    &ContactRule::default(),
                    Planted::AsSeen,
                    0.0,
                )?;
                (locked.joints, locked.missed)
            }
            false => (moved, 0.0),
        };
        self.measured(joints, skeleton, legs_short)
    }

    /// Moves an unconditional motion onto the path; locks feet with `lock_feet`. A path that is
    /// longer than [`LONGEST_STRIDE`] times the motion's own is followed so far.
    ///
    /// # Errors
    /// If the motion does not fit the skeleton.
    pub fn warped(
        &self,
        joints: &Joints,
        skeleton: &Skeleton,
        lock_feet: bool,
    ) -> Result<Followed, Error> {
        let asked = self.course.metres.last().copied().unwrap_or(0.0);
        let own = Course::through(root_trajectory(
            &joints.track(0),
            skeleton.description().fps,
        ));
        let walked = own.metres.last().copied().unwrap_or(0.0);
        let reached = asked.min(LONGEST_STRIDE * walked);
        let line = self.line.up_to(reached);
        let warped = Self::WARP.apply(joints, skeleton, &line);
        let warped = warped.map_err(|error| {
            let message = format!("the motion cannot be moved onto the path: {error}");
            Error::usage(message, "docs/paths.md")
        })?;
        let followed = self.with_feet(warped.joints, joints, skeleton, lock_feet)?;
        let cut = (reached < asked).then_some(Cut { asked, walked });
        Ok(Followed { cut, ..followed })
    }
}

/// Speed of training roots along either ground axis, m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fastest {
    /// The maximum.
    Measured(f64),
    /// Five deviations from the mean: published statistics have no maximum.
    Estimated(f64),
}

impl Fastest {
    /// The speed, m/s.
    pub fn speed(self) -> f64 {
        let (Self::Measured(speed) | Self::Estimated(speed)) = self;
        speed
    }

    /// The speed of the root in features of `skeleton`.
    pub fn of_clips(statistics: &Statistics, skeleton: &Skeleton) -> Self {
        // Displacements of joint 0 in the facing frame, meters per frame.
        let first = skeleton.layout().velocities().start;
        Self::of(statistics, first, skeleton.description().fps)
    }

    /// The speed from velocity channels starting at `first`, times `scale`.
    pub fn of(statistics: &Statistics, first: usize, scale: f64) -> Self {
        let most = |of: &dyn Fn(usize) -> f64| of(first).max(of(first + 2)) * scale;
        match &statistics.range {
            Some([min, max]) => {
                Self::Measured(most(&|channel| min[channel].abs().max(max[channel].abs())))
            }
            None => Self::Estimated(most(&|channel| {
                statistics.mean[channel].abs() + 5.0 * statistics.std[channel]
            })),
        }
    }
}

/// Smoothing window of a root trajectory, seconds, which removes the sway of the steps.
const SMOOTH: f64 = 1.0;

/// The smoothed ground trajectory of a root at `places`, one point per frame.
pub fn root_trajectory(places: &[[f64; 3]], fps: f64) -> Vec<[f64; 2]> {
    let window = 2 * (SMOOTH * fps / 2.0) as usize + 1;
    let track: Vec<[f64; 2]> = places.iter().map(|[x, _, z]| [*x, *z]).collect();
    smoothed(&track, window, 3)
}

/// Largest ratio of a warped motion's steps to its own: longer ones slide.
pub const LONGEST_STRIDE: f64 = 1.3;

/// A path that is longer than the motion's legs reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Distance that the path asks for, metres.
    pub asked: f64,
    /// Distance that the motion walks by itself, metres.
    pub walked: f64,
}

impl Cut {
    /// The warning for a motion of `frames` frames.
    pub fn warning(&self, frames: usize, fps: f64) -> String {
        let Self { asked, walked } = self;
        let reached = LONGEST_STRIDE * walked;
        let hint = match *walked > 0.2 * asked {
            true => {
                let needed = frames as f64 * asked / walked;
                format!("give it {:.1} seconds ({needed:.0} frames)", needed / fps)
            }
            false => "ask for motion that walks".to_owned(),
        };
        format!(
            "the path asks for {asked:.2} m and the motion walks {walked:.2} m: it follows the first \
             {reached:.2} m, {LONGEST_STRIDE} times its own steps; {hint}, or set the path's `speed`"
        )
    }
}

/// A motion on its path.
#[derive(Clone, Debug)]
pub struct Followed {
    /// The joint positions.
    pub joints: Joints,
    /// The deviation from the path.
    pub report: PathReport,
    /// Largest distance between a foot and its locked position, meters; nonzero if a leg is too
    /// short.
    pub legs_short: f64,
    /// The lengths of a path that was followed in part.
    pub cut: Option<Cut>,
}

/// The features of joints on a path, with the bone lengths of these joints.
///
/// # Errors
/// If the joints do not fit `skeleton`, or have a single frame.
pub fn features_of(joints: &Joints, skeleton: &Skeleton, root: Root) -> Result<Features, Error> {
    let unscaled = Extraction {
        rescale: false,
        ..Extraction::default()
    };
    Ok(unscaled
        .features_of_all_frames(skeleton, joints)?
        .with_root(root))
}

/// The path of a request, for a motion of some frames.
pub struct FollowedPath {
    file: PathBuf,
    plan: PathPlan,
    /// The target positions.
    pub target: PathTarget,
}

impl FollowedPath {
    /// The path of `file` for `frames` frames at `fps` frames per second.
    ///
    /// # Errors
    /// If the file is not a path.
    pub fn read(file: &PathFile, frames: usize, fps: f64) -> Result<Self, Error> {
        let (file, plan) = read_path(file)?;
        let target = PathTarget::new(&plan, frames, fps)?;
        Ok(Self { file, plan, target })
    }

    /// The warning about a path that is faster than training motion.
    pub fn too_fast(&self, fps: f64, fastest: Fastest) -> Option<String> {
        self.target.too_fast(&self.file, fps, fastest)
    }

    /// The record of a motion on the path.
    pub fn record(&self, report: PathReport, settings: Option<Value>) -> PathRecord {
        PathRecord {
            file: self.file.clone(),
            content: self.plan.clone(),
            settings,
            report,
        }
    }
}

/// The path of a request, with its file.
pub fn read_path(path: &PathFile) -> Result<(PathBuf, PathPlan), Error> {
    let file = path.file.display().to_string();
    let refused = |message: String| Error::usage(message, "docs/paths.md describes paths");
    let text = read_text(&path.file).map_err(|error| refused(format!("{file}: {error}")))?;
    let plan = PathPlan::read(&text, &file, path.metres_per_unit);
    let plan = plan.map_err(|error| refused(error.to_string()))?;
    Ok((path.file.clone(), plan))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_beyond_the_speeds_of_training_is_reported() {
        let mut statistics = Statistics::new(vec![0.1, 0.0, 0.2], vec![0.02, 1.0, 0.01], None);
        let of = |statistics: &Statistics| Fastest::of(statistics, 0, 20.0);
        let known = statistics.as_mut().expect("statistics");
        // 0.1 + 5 0.02 and 0.2 + 5 0.01 meters per frame.
        assert_eq!(of(known), Fastest::Estimated(5.0));
        known.range = Some([vec![-0.5, -9.0, 0.0], vec![0.3, 9.0, 0.4]]);
        assert_eq!(of(known), Fastest::Measured(10.0));

        let plan = PathPlan::line(vec![[0.0, 0.0], [0.0, 30.0]]);
        let target = PathTarget::new(&plan, 61, 20.0).expect("a path");
        let warning = |fastest| target.too_fast(Path::new("p.toml"), 20.0, fastest);
        assert_eq!(warning(Fastest::Measured(10.5)), None);
        for (fastest, expected) in [
            (Fastest::Measured(6.0), "4.00 m/s more than any motion"),
            (
                Fastest::Estimated(6.5),
                "3.50 m/s more than five deviations",
            ),
        ] {
            let text = warning(fastest).expect("too fast");
            assert!(text.contains("p.toml asks for 10.00 m/s"), "{text}");
            assert!(text.contains(expected), "{text}");
        }
    }
}
