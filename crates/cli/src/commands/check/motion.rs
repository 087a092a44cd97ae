//! A motion that is checked: an array, or a BVH file.

use std::path::Path;

use kinegrad_capture::clips::Body;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::{
    BodyValue, CHANNELS, CapturedBody, JointPositions, Phrase, Profile, Report, Representation,
    SanityThresholds, Statistics, check_capture, check_thresholds,
};
use kinegrad_train::{Error, Systems};
use miette::Diagnostic;

use crate::io::{self, BvhReading, Capture, MotionArray, is_bvh, read_bvh};

/// Frames per second at which a capture's jerk and sliding are measured, as those of the reference
/// motion.
const FPS: f64 = 20.0;

/// A motion that is checked.
pub enum Motion {
    /// An array of a known representation.
    Array(MotionArray),
    /// A body in a BVH file.
    Capture(Box<CapturedFile>),
}

impl Motion {
    /// Reads an array, or a BVH file in the units and axes of `reading`.
    pub fn read(systems: Systems<'_>, path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        if is_bvh(path) {
            reading.must_suit_bvh(path)?;
            let captured = CapturedFile::read(path, reading)?;
            return Ok(Self::Capture(Box::new(captured)));
        }
        match io::Motion::read(systems, path, reading)? {
            io::Motion::Array(array) => Ok(Self::Array(array)),
            io::Motion::Points(joints, _, error) => Err(unknown(path, &joints, &error)),
            io::Motion::Bvh(_) => unreachable!("read above"),
        }
    }

    /// The representation whose statistics are its bounds; `None` for a body of another skeleton.
    pub fn representation(&self) -> Option<&dyn Representation> {
        match self {
            Self::Array(array) => Some(&*array.representation),
            Self::Capture(captured) => {
                let representation = captured.representation.as_ref();
                representation.map(|positions| positions as &dyn Representation)
            }
        }
    }

    /// The profile `ccmotion` with these bounds. Fails unless the motion is a phrase.
    pub fn check_thresholds(
        &self,
        path: &Path,
        thresholds: &SanityThresholds,
    ) -> Result<Report, Error> {
        match self {
            Self::Array(array) if array.representation.stored_channels() == CHANNELS => {
                let phrase = Phrase::new(array.values.clone())?;
                Ok(check_thresholds(&phrase, thresholds))
            }
            _ => Err(Error::usage(
                format!(
                    "{}: option `thresholds` is for phrases alone",
                    path.display()
                ),
                "the five checks and their bounds are those of phrases `[T, 25]`",
            )),
        }
    }

    /// The checks. A BVH file has those of `strict` alone.
    pub fn check(&self, profile: Profile, statistics: Option<&Statistics>) -> Report {
        match self {
            Self::Array(array) => array
                .representation
                .check(&array.values, profile, statistics),
            Self::Capture(captured) => captured.check(statistics),
        }
    }
}

/// The error for joints of an unknown skeleton.
fn unknown(path: &Path, joints: &Joints, error: &Error) -> Error {
    let known = error.help().map(|hint| hint.to_string());
    let (path, known, joints) = (path.display(), known.unwrap_or_default(), joints.joints());
    Error::usage(
        format!("{path}: {joints} joints of an unknown skeleton cannot be checked"),
        format!("{known}; `kinegrad view` and `kinegrad plot` show joints of any skeleton"),
    )
}

/// The body in a BVH file.
pub struct CapturedFile {
    body: Body,
    joint_names: Vec<String>,
    /// The representation of the 22 joints of HumanML3D, if the file has them.
    representation: Option<JointPositions>,
    /// The largest turn of its trunk, if the file has other joints.
    largest_turn: Option<BodyValue>,
}

impl CapturedFile {
    fn read(path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        let bvh = read_bvh(path)?;
        match Body::of_bvh(&bvh, reading.units, reading.up) {
            Ok(body) => {
                for note in &body.notes {
                    tell!("note: {}: {note}", path.display());
                }
                let skeleton = Skeleton::humanml3d();
                Ok(Self {
                    body,
                    joint_names: skeleton.description().joint_names.clone(),
                    representation: Some(JointPositions { skeleton }),
                    largest_turn: None,
                })
            }
            Err(reason) => Self::of_any(path, reading, &reason),
        }
    }

    /// The joints of the file itself; `reason` is why the 22 joints are not known.
    fn of_any(path: &Path, reading: &BvhReading, reason: &str) -> Result<Self, Error> {
        tell!(
            "note: {}: checked without the joints of HumanML3D, because {reason}",
            path.display()
        );
        let capture = Capture::read(path, reading)?;
        let rate = 1.0 / capture.bvh.frame_time();
        let turn = capture.bvh.largest_turn();
        Ok(Self {
            body: Body {
                joints: capture.joints()?,
                rate,
                metres_per_unit: capture.metres,
                up: capture.up,
                notes: Vec::new(),
            },
            joint_names: io::names(&capture.bvh),
            representation: None,
            largest_turn: turn.map(|(frame, degrees)| BodyValue {
                value: rate * degrees,
                frame: Some(frame),
                joint: None,
            }),
        })
    }

    fn check(&self, statistics: Option<&Statistics>) -> Report {
        let Body { joints, rate, .. } = &self.body;
        let fps = rate.min(FPS);
        let captured = CapturedBody {
            joints,
            fps: *rate,
            resampled: &self.body.at_rate(fps),
            resampled_fps: fps,
            joint_names: &self.joint_names,
            skeleton: (self.representation.as_ref()).map(|positions| &positions.skeleton),
            largest_turn: self.largest_turn,
        };
        check_capture(&captured, statistics)
    }
}
