//! Reads a motion of any kind.

use std::path::{Path, PathBuf};

use kinegrad_data::file::read_file;
use kinegrad_data::{Array, MotionFile};
use kinegrad_motion::Representation;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_train::{Error, Systems};
use serde::Deserialize;

use super::bvh::{BvhReading, Capture, is_bvh};
use super::find::COMPANIONS;

/// Frames per second of joints of an unknown skeleton.
const POINTS_RATE: f64 = 30.0;

/// Largest record that is read, bytes.
const LARGEST_RECORD: u64 = 1 << 26;

/// A motion that was read from a file.
pub enum Motion {
    /// An array of a known representation.
    Array(MotionArray),
    /// Joint positions `[T, J, 3]` of an unknown skeleton, their frames per second, and the error of
    /// commands that need a skeleton.
    Points(Joints, f64, Error),
    /// A BVH file.
    Bvh(Capture),
}

impl Motion {
    /// Reads a BVH file, or an array of any kind. Fails if the file cannot be read or is not a
    /// motion.
    pub fn read(systems: Systems<'_>, path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        if is_bvh(path) {
            reading.must_suit_bvh(path)?;
            return Capture::read(path, reading).map(Self::Bvh);
        }
        let array = read_frames(path, reading.index)?;
        match (
            recognise(systems, path, &array, reading.fps),
            &array.shape[..],
        ) {
            (Ok(representation), _) => {
                Ok(Self::Array(MotionArray::new(path, representation, array)))
            }
            (Err(error), &[frames, joints, 3]) if frames > 0 && joints > 0 => {
                let places = Joints::from_f32(&array.values, joints)?;
                let fps = checked_rate(reading.fps)?.unwrap_or(POINTS_RATE);
                Ok(Self::Points(places, fps, error))
            }
            (Err(error), _) => Err(error),
        }
    }
}

/// Refuses the number of a motion that a file of `count` motions lacks.
fn must_have(path: &Path, index: usize, count: usize) -> Result<(), Error> {
    if index < count {
        return Ok(());
    }
    let path = path.display();
    let message = match count {
        1 => format!("option `index {index}`, and {path} has one motion"),
        _ => format!("option `index {index}`, and {path} has {count} motions"),
    };
    Err(Error::usage(message, "motions count from 0"))
}

/// Motion `index` of a `.npy` file, one row per frame. Other programs store joint positions with the
/// frames last, `[J, 3, T]`, several motions as `[N, J, 3, T]`, and both in pickled dictionaries.
fn read_frames(path: &Path, index: Option<usize>) -> Result<Array, Error> {
    let (array, lengths) = match MotionFile::read(path)? {
        MotionFile::Array(array) => (array, None),
        MotionFile::Results(results) => (results.motion, results.lengths),
    };
    let (count, joints, frames) = match array.shape[..] {
        [joints, 3, frames] if frames != 3 => (1, joints, frames),
        [count, joints, 3, frames] => (count, joints, frames),
        _ => {
            must_have(path, index.unwrap_or(0), 1)?;
            return Ok(array);
        }
    };
    if index.is_none() && count > 1 {
        let path = path.display();
        tell!("note: {path} has {count} motions, this is the first: `--index 1` takes the next");
    }
    let index = index.unwrap_or(0);
    must_have(path, index, count)?;
    let values = &array.values[index * joints * 3 * frames..];
    let length = lengths.map_or(frames, |lengths| lengths[index]);
    let rows = (0..length).flat_map(|t| (0..3 * joints).map(move |row| values[row * frames + t]));
    Ok(Array {
        values: rows.collect(),
        shape: vec![length, joints, 3],
    })
}

/// The representation of an array at the rate of option `fps`, or of the record beside the file.
fn recognise(
    systems: Systems<'_>,
    path: &Path,
    array: &Array,
    fps: Option<f64>,
) -> Result<Box<dyn Representation>, Error> {
    let found = systems.representation_of(path, &array.shape, &array.values)?;
    let given = checked_rate(fps)?;
    let Some(fps) = given.or_else(|| rate_beside(path)) else {
        return Ok(found);
    };
    if fps == found.fps() {
        return Ok(found);
    }
    match (found.at_rate(fps), given) {
        (Some(at_rate), _) => Ok(at_rate),
        (None, None) => Ok(found),
        (None, Some(_)) => {
            let message = format!(
                "option `fps {fps}`, and a {} has {} frames per second",
                found.name(),
                found.fps()
            );
            Err(Error::usage(message, "leave it out"))
        }
    }
}

fn checked_rate(fps: Option<f64>) -> Result<Option<f64>, Error> {
    match fps {
        Some(fps) if !(fps.is_finite() && fps > 0.0) => Err(Error::usage(
            format!("`--fps` is {fps}"),
            "frames per second are a positive number, such as 30",
        )),
        _ => Ok(fps),
    }
}

/// Frames per second in the record that `kinegrad sample` or `warp` wrote beside a motion.
fn rate_beside(path: &Path) -> Option<f64> {
    #[derive(Deserialize)]
    struct Record {
        kinegrad: String,
        fps: f64,
    }
    let name = path.file_name()?.to_str()?;
    let stem = COMPANIONS
        .iter()
        .find_map(|ending| name.strip_suffix(*ending));
    let stem = stem.or_else(|| name.strip_suffix(".npy"))?;
    let record = path.with_file_name(format!("{stem}.json"));
    let bytes = read_file(&record, LARGEST_RECORD).ok()?;
    let Record { kinegrad, fps } = serde_json::from_slice(&bytes).ok()?;
    (!kinegrad.is_empty() && fps.is_finite() && fps > 0.0).then_some(fps)
}

/// An array of a known representation.
pub struct MotionArray {
    /// The file.
    pub path: PathBuf,
    /// The meaning of a row.
    pub representation: Box<dyn Representation>,
    /// Number of rows.
    pub frames: usize,
    /// The rows.
    pub values: Vec<f32>,
}

impl MotionArray {
    fn new(path: &Path, representation: Box<dyn Representation>, array: Array) -> Self {
        Self {
            path: path.to_path_buf(),
            representation,
            frames: array.shape[0],
            values: array.values,
        }
    }

    /// Reads a `.npy` file. Fails if the file cannot be read, or no system knows its representation.
    pub fn read(systems: Systems<'_>, path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        let array = read_frames(path, reading.index)?;
        let representation = recognise(systems, path, &array, reading.fps)?;
        Ok(Self::new(path, representation, array))
    }

    /// Joint positions and their skeleton. Fails if the representation has no body, or a position
    /// is not finite.
    pub fn body(&self) -> Result<(Joints, Skeleton), Error> {
        let Some(skeleton) = self.representation.skeleton() else {
            let (path, name) = (self.path.display(), self.representation.name());
            return Err(Error::usage(
                format!("{path}: a {name} has no body"),
                "give joint features, or joint positions of 22 or 21 joints, such as `kinegrad \
                 sample` of a run on clips writes",
            ));
        };
        let joints = self.representation.joints(&self.values);
        let joints = joints.ok_or_else(|| not_finite(&self.path))?;
        Ok((joints, skeleton.clone()))
    }
}

/// The error of a motion with a position that is not finite.
pub fn not_finite(path: &Path) -> Error {
    Error::usage(
        format!("{}: a position is not finite", path.display()),
        "`kinegrad check` lists the problems of a motion",
    )
}
