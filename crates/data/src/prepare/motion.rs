//! From a capture file to the way of a root.

use std::path::Path;

use kinegrad_motion::capture::{Bvh, C3d, CaptureError, MarkerGaps, RootSource, RootTrack};
use kinegrad_motion::phrase::{POSITION, QUATERNION};
use kinegrad_motion::{CHANNELS, Quaternion};

use super::plan::TakePlan;
use super::report::capture_error;
use crate::npy::{self, Array, MAX_FRAMES};
use crate::{FileError, npz};

/// The longest capture file: an hour of full-body marker data.
const MAX_BYTES: u64 = 2 << 30;

/// A take's root, with what was found missing.
pub(super) struct Capture {
    pub source: Box<dyn RootSource + Send + Sync>,
    pub gaps: Vec<MarkerGaps>,
}

/// Reads a capture file of any known kind, as the take says.
///
/// # Errors
/// What is wrong with the file, in words that name it.
pub(super) fn read(path: &Path, take: &TakePlan) -> Result<Capture, String> {
    let file = path.display().to_string();
    let bytes = bytes(path)?;
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let in_file = |error: CaptureError| {
        let text = capture_error(error);
        match text.contains(&file) {
            true => text,
            false => format!("{file}: {text}"),
        }
    };
    let plain = |source: RootTrack| Capture {
        source: Box::new(source),
        gaps: Vec::new(),
    };
    match ending.to_ascii_lowercase().as_str() {
        "bvh" => bvh(&bytes, &file, take).map(plain).map_err(in_file),
        "c3d" => {
            let c3d = C3d::parse(&bytes, &file).map_err(in_file)?;
            let markers = take.markers.clone().unwrap_or_default();
            let root = markers.root(&c3d).map_err(in_file)?;
            Ok(Capture {
                gaps: root.gaps().to_vec(),
                source: Box::new(root),
            })
        }
        "npy" => npy::parse(&bytes, &file)
            .and_then(|array| of_array(array, &file, take))
            .map(plain)
            .map_err(|error| error.to_string()),
        "npz" => npz::parse_arrays(&bytes, &file, &[("position", 3), ("quaternion", 4)])
            .and_then(|arrays| of_arrays(&arrays, &file, take))
            .map(plain)
            .map_err(|error| error.to_string()),
        other => Err(format!(
            "{file}: ending `{other}` found; bvh, c3d, npy and npz allowed"
        )),
    }
}

/// The bytes of a file that may be as long as [`MAX_BYTES`].
pub(super) fn bytes(path: &Path) -> Result<Vec<u8>, String> {
    let named = |problem: String| format!("{}: {problem}", path.display());
    let length = std::fs::metadata(path)
        .map_err(|e| named(e.to_string()))?
        .len();
    if length > MAX_BYTES {
        return Err(named(format!("{length} bytes found, {MAX_BYTES} allowed")));
    }
    std::fs::read(path).map_err(|e| named(e.to_string()))
}

fn bvh(bytes: &[u8], file: &str, take: &TakePlan) -> Result<RootTrack, CaptureError> {
    let bvh = Bvh::parse(bytes, file)?;
    let metres = take.units.unwrap_or_default().metres();
    let up = take.up.unwrap_or_default();
    let Some(name) = &take.joint else {
        return bvh.root_track(metres, up);
    };
    let Some(joint) = bvh.joint(name) else {
        let names: Vec<&str> = bvh.joints().iter().map(|j| j.name.as_str()).collect();
        return Err(CaptureError::MissingJoint {
            file: file.to_owned(),
            joint: name.clone(),
            available: names.join(", "),
        });
    };
    bvh.joint_track(joint, metres, up)
}

/// `[T, 25]` phrases, or `[T, 7]`: position (m, y-up) and quaternion w, x, y, z.
fn of_array(array: Array, file: &str, take: &TakePlan) -> Result<RootTrack, FileError> {
    let rows = |position: usize, quaternion: usize, width: usize| {
        let frames = array.values.chunks_exact(width);
        let part = |frame: &[f32], first: usize| f64::from(frame[first]);
        let positions = frames
            .clone()
            .map(|f| [0, 1, 2].map(|i| part(f, position + i)))
            .collect();
        let orientations = frames
            .map(|f| {
                let [w, x, y, z] = [0, 1, 2, 3].map(|i| part(f, quaternion + i));
                Quaternion::new(w, x, y, z)
            })
            .collect();
        (positions, orientations)
    };
    let (positions, orientations) = match array.shape[..] {
        [frames, 7] if frames <= MAX_FRAMES => rows(0, 3, 7),
        [frames, CHANNELS] if frames <= MAX_FRAMES => {
            rows(POSITION.start, QUATERNION.start, CHANNELS)
        }
        _ => {
            return Err(FileError::Shape {
                file: file.to_owned(),
                found: format!("{:?}", array.shape),
                allowed: format!("[frames, 7] or [frames, 25] with at most {MAX_FRAMES} frames"),
            });
        }
    };
    track(positions, orientations, file, take)
}

fn of_arrays(arrays: &[Array], file: &str, take: &TakePlan) -> Result<RootTrack, FileError> {
    let numbers = |array: &Array, width: usize| -> Vec<Vec<f64>> {
        let frames = array.values.chunks_exact(width);
        frames
            .map(|frame| frame.iter().map(|&value| f64::from(value)).collect())
            .collect()
    };
    let positions = numbers(&arrays[0], 3);
    let orientations = numbers(&arrays[1], 4);
    track(
        positions.into_iter().map(|p| [p[0], p[1], p[2]]).collect(),
        orientations
            .into_iter()
            .map(|q| Quaternion::new(q[0], q[1], q[2], q[3]))
            .collect(),
        file,
        take,
    )
}

fn track(
    positions: Vec<[f64; 3]>,
    orientations: Vec<Quaternion>,
    file: &str,
    take: &TakePlan,
) -> Result<RootTrack, FileError> {
    let fps = take.fps.unwrap_or(kinegrad_motion::FPS);
    RootTrack::new(positions, orientations, fps).map_err(|error| FileError::Read {
        file: file.to_owned(),
        reason: error.to_string(),
    })
}
