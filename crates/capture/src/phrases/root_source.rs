//! From a capture file to a root track.

use std::path::Path;

use kinegrad_data::{FileError, MAX_FRAMES, parse_array, parse_arrays};
use kinegrad_motion::phrase::{POSITION, QUATERNION};
use kinegrad_motion::{CHANNELS, Quaternion};

use crate::plan::TakePlan;
use crate::prepare::files::bytes;
use crate::{Bvh, C3d, Error, RootPose, RootSource, RootTrack};

/// Reads a capture file with the take's settings.
pub(super) fn read(path: &Path, take: &TakePlan) -> Result<Box<dyn RootSource>, String> {
    let file = path.display().to_string();
    let bytes = bytes(path)?;
    let in_file = |error: Error| {
        let text = error.with_hint();
        match text.contains(&file) {
            true => text,
            false => format!("{file}: {text}"),
        }
    };
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let track = match ending.to_ascii_lowercase().as_str() {
        "bvh" => bvh(&bytes, &file, take).map_err(in_file)?,
        "c3d" => {
            let markers = take.markers.clone().unwrap_or_default();
            let root = C3d::parse(&bytes, &file).and_then(|c3d| markers.root(&c3d));
            return Ok(Box::new(root.map_err(in_file)?));
        }
        "npy" => array(&bytes, &file, take).map_err(|error| error.to_string())?,
        "npz" => arrays(&bytes, &file, take).map_err(|error| error.to_string())?,
        other => {
            let allowed = "bvh, c3d, npy and npz allowed";
            return Err(format!("{file}: ending `{other}` found; {allowed}"));
        }
    };
    Ok(Box::new(track))
}

fn bvh(bytes: &[u8], file: &str, take: &TakePlan) -> Result<RootTrack, Error> {
    let bvh = Bvh::parse(bytes, file)?;
    let metres = take.units.unwrap_or_default().metres();
    let up = take.up.unwrap_or_default();
    let Some(name) = &take.joint else {
        return bvh.root_track(metres, up);
    };
    let Some(joint) = bvh.joint(name) else {
        let names: Vec<&str> = bvh.joints().iter().map(|j| j.name.as_str()).collect();
        return Err(Error::Name {
            problem: format!("`{file}` has no joint `{name}`"),
            hint: format!("its joints are: {}", names.join(", ")),
        });
    };
    bvh.joint_track(joint, metres, up)
}

/// `[T, 25]` phrases, or `[T, 7]`: position (m, y-up) and quaternion w, x, y, z.
fn array(bytes: &[u8], file: &str, take: &TakePlan) -> Result<RootTrack, FileError> {
    let array = parse_array(bytes, file)?;
    let (width, position, quaternion) = match array.shape[..] {
        [frames, 7] if frames <= MAX_FRAMES => (7, 0..3, 3..7),
        [frames, CHANNELS] if frames <= MAX_FRAMES => (CHANNELS, POSITION, QUATERNION),
        _ => {
            let allowed = format!("[frames, 7] or [frames, 25] with at most {MAX_FRAMES} frames");
            return Err(FileError::shape(file, &array.shape, allowed));
        }
    };
    let frames = array.values.chunks_exact(width);
    let parts = frames.map(|frame| (&frame[position.clone()], &frame[quaternion.clone()]));
    track(parts, file, take)
}

/// Arrays `position` `[T, 3]` (m, y-up) and `quaternion` `[T, 4]` (w, x, y, z).
fn arrays(bytes: &[u8], file: &str, take: &TakePlan) -> Result<RootTrack, FileError> {
    let arrays = parse_arrays(bytes, file, &[("position", 3), ("quaternion", 4)])?;
    let positions = arrays[0].values.chunks_exact(3);
    track(positions.zip(arrays[1].values.chunks_exact(4)), file, take)
}

/// The track of frames of a position and a quaternion each.
fn track<'a>(
    frames: impl Iterator<Item = (&'a [f32], &'a [f32])>,
    file: &str,
    take: &TakePlan,
) -> Result<RootTrack, FileError> {
    let pose = |(position, quaternion): (&[f32], &[f32])| {
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| f64::from(quaternion[i]));
        Some(RootPose {
            position: [0, 1, 2].map(|i| f64::from(position[i])),
            orientation: Quaternion::new(w, x, y, z),
        })
    };
    let fps = take.fps.unwrap_or(kinegrad_motion::FPS);
    let track = RootTrack::from_poses(frames.map(pose).collect(), fps);
    track.map_err(FileError::read(file.as_ref()))
}
