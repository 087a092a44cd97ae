//! Reads a motion of any kind.

use std::path::{Path, PathBuf};

use kinegrad_data::{Array, MotionFile};
use kinegrad_motion::Representation;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_train::{Error, Systems};

use super::bvh::{BvhReading, Capture, is_bvh};

/// A motion that was read from a file.
pub enum Motion {
    /// An array of a known representation.
    Array(MotionArray),
    /// Joint positions `[T, J, 3]` of an unknown skeleton, and the error of commands that need a
    /// skeleton.
    Points(Joints, Error),
    /// A BVH file.
    Bvh(Capture),
}

impl Motion {
    /// Reads a BVH file, or an array of any kind. Fails if the file cannot be read or is not a
    /// motion.
    pub fn read(systems: Systems<'_>, path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        if is_bvh(path) {
            must_have(path, reading.index.unwrap_or(0), 1)?;
            return Capture::read(path, reading).map(Self::Bvh);
        }
        let array = read_frames(path, reading.index)?;
        match (recognise(systems, path, &array), &array.shape[..]) {
            (Ok(representation), _) => {
                Ok(Self::Array(MotionArray::new(path, representation, array)))
            }
            (Err(error), &[frames, joints, 3]) if frames > 0 && joints > 0 => {
                let places = Joints::from_f32(&array.values, joints)?;
                Ok(Self::Points(places, error))
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

fn recognise(
    systems: Systems<'_>,
    path: &Path,
    array: &Array,
) -> Result<Box<dyn Representation>, Error> {
    systems.representation_of(path, &array.shape, &array.values)
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

    /// Reads motion `index` of a `.npy` file. Fails if the file cannot be read, or no system knows
    /// its representation.
    pub fn read(systems: Systems<'_>, path: &Path, index: Option<usize>) -> Result<Self, Error> {
        let array = read_frames(path, index)?;
        let representation = recognise(systems, path, &array)?;
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
