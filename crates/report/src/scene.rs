//! Scenes for viewers, animated pictures and exported files: moving objects, marks on the floor,
//! and a song.

use std::ops::{Mul, Sub};

use serde::{Deserialize, Serialize};

/// Moving objects side by side.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Title of the page.
    pub title: String,
    /// The objects; all start at the same time.
    pub objects: Vec<SceneObject>,
    /// Goal of position control, on the floor.
    pub floor: Floor,
    /// Music played with the motion.
    pub song: Option<Song>,
}

/// A moving object: a body, or a lone root. Units are meters, +y is up.
#[derive(Clone, Debug, Default)]
pub struct SceneObject {
    /// Its name.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Joint positions, `[frames, joints, 3]`, finite; joint 0 is the root.
    pub positions: Vec<f32>,
    /// Name of each joint.
    pub joint_names: Vec<String>,
    /// The parent of each joint.
    pub parents: Vec<Option<usize>>,
    /// Orientations (w, x, y, z) of a lone root, one per frame. A lone root with orientations is
    /// shown as an oriented body.
    pub orientations: Option<Vec<[f32; 4]>>,
    /// Ground contacts.
    pub contacts: Vec<Contact>,
    /// Curves over time.
    pub curves: Vec<Curves>,
    /// Source frames, for a motion made from examples.
    pub origins: Option<Origins>,
    /// Rest pose and rotations, if its file has them.
    pub hierarchy: Option<Hierarchy>,
}

/// Rest pose and motion of the joints within their parents; every joint after its parent.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// Rest position of each joint, meters, `[joints, 3]`.
    pub offsets: Vec<[f32; 3]>,
    /// Positions, meters, `[frames, joints, 3]`.
    pub translations: Vec<[f32; 3]>,
    /// Rotations (w, x, y, z), `[frames, joints, 4]`.
    pub rotations: Vec<[f32; 4]>,
}

/// Source frames of a motion made from examples.
#[derive(Clone, Debug, Default)]
pub struct Origins {
    /// Name and number of frames of each example.
    pub examples: Vec<(String, usize)>,
    /// The parts that were matched separately.
    pub parts: Vec<PartOrigins>,
}

/// Source frames of a part of the body.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PartOrigins {
    /// Its name.
    pub name: String,
    /// Consecutive frames of an example: first frame, example, first frame in the example, number
    /// of frames.
    pub runs: Vec<[usize; 4]>,
}

/// Ground contact of a joint.
#[derive(Clone, Debug)]
pub struct Contact {
    /// The joint.
    pub joint: usize,
    /// Contact, one value per frame.
    pub frames: Vec<bool>,
}

/// Curves with one axis.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Title, with the unit.
    pub title: String,
    /// Name and values of each curve, one value per frame.
    pub series: Vec<(String, Vec<f32>)>,
}

/// Marks on the floor. Points are `[x, z]` in meters.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Floor {
    /// Path to follow.
    pub path: Vec<[f32; 2]>,
    /// Frame and place of each key frame.
    pub keyframes: Vec<(usize, [f32; 2])>,
    /// Center and radius of each obstacle.
    pub obstacles: Vec<([f32; 2], f32)>,
    /// Corners of each polygonal obstacle.
    pub polygons: Vec<Vec<[f32; 2]>>,
}

/// Music of a motion.
#[derive(Clone, Debug)]
pub struct Song {
    /// Format of the file.
    pub format: SongFormat,
    /// The file.
    pub bytes: Vec<u8>,
    /// Time in the song at which the motion starts, seconds.
    pub start: f64,
    /// Beats, in seconds of the song.
    pub beats: Vec<f64>,
}

/// Format of a song's file.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum SongFormat {
    /// MPEG audio.
    Mp3,
    /// RIFF WAVE.
    Wav,
    /// FLAC.
    Flac,
    /// Ogg.
    Ogg,
}

impl SongFormat {
    /// The format by the file's first bytes, behind ID3 tags; the name is not evidence. `None` for
    /// other files.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes;
        while let [b'I', b'D', b'3', _, _, _, a, b, c, d, ..] = *rest {
            // Seven bits of each byte count.
            let size = [a, b, c, d]
                .iter()
                .fold(0, |size, byte| size << 7 | usize::from(byte & 127));
            rest = rest.get(10 + size..)?;
        }
        match *rest {
            [b'R', b'I', b'F', b'F', _, _, _, _, ref form @ ..] if form.starts_with(b"WAVE") => {
                Some(Self::Wav)
            }
            [b'f', b'L', b'a', b'C', ..] => Some(Self::Flac),
            [b'O', b'g', b'g', b'S', ..] => Some(Self::Ogg),
            // Eleven bits set, then version and layer, which AAC does not have.
            [0xff, second, ..] if second & 0xe0 == 0xe0 && second & 0x06 != 0 => Some(Self::Mp3),
            _ => None,
        }
    }

    /// Media type, for pages.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Mp3 => "audio/mpeg",
            Self::Wav => "audio/wav",
            Self::Flac => "audio/flac",
            Self::Ogg => "audio/ogg",
        }
    }

    /// Name of ffmpeg's demuxer.
    pub fn demuxer(self) -> &'static str {
        match self {
            Self::Mp3 => "mp3",
            Self::Wav => "wav",
            Self::Flac => "flac",
            Self::Ogg => "ogg",
        }
    }
}

impl SceneObject {
    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.parents.len()
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.positions.len() / (3 * self.joints()).max(1)
    }

    /// Length in seconds.
    pub fn seconds(&self) -> f64 {
        self.frames() as f64 / self.fps
    }

    /// The children of each joint.
    pub(crate) fn children(&self) -> Vec<Vec<usize>> {
        children_of(self.parents.iter().copied())
    }

    /// Position of a joint in a frame.
    pub fn joint(&self, frame: usize, joint: usize) -> [f32; 3] {
        let at = 3 * (frame * self.joints() + joint);
        [0, 1, 2].map(|axis| self.positions[at + axis])
    }
}

impl Scene {
    /// Length of the longest object in seconds.
    pub fn seconds(&self) -> f64 {
        let lengths = self.objects.iter().map(SceneObject::seconds);
        let finite = lengths.filter(|length| length.is_finite());
        finite.fold(0.0, f64::max)
    }

    /// Frame time of the object with the highest frame rate; 0 without objects.
    pub fn frame_seconds(&self) -> f64 {
        let rates = self.objects.iter().map(|object| object.fps);
        let fps = rates.fold(0.0, f64::max);
        if fps > 0.0 { 1.0 / fps } else { 0.0 }
    }
}

/// A pose of an object at a time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pose {
    /// Position of each joint.
    pub joints: Vec<[f32; 3]>,
    /// Orientation of a lone root (w, x, y, z).
    pub orientation: Option<[f32; 4]>,
}

/// The side of the body of a joint.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) enum Side {
    Left,
    Right,
    Middle,
}

/// The children of each of the nodes with these parents.
pub(crate) fn children_of(
    parents: impl ExactSizeIterator<Item = Option<usize>>,
) -> Vec<Vec<usize>> {
    let mut children = vec![Vec::new(); parents.len()];
    for (child, parent) in parents.enumerate() {
        if let Some(parent) = parent {
            children[parent].push(child);
        }
    }
    children
}

impl SceneObject {
    /// The frame at a time, and the part of the way to the next frame; the last frame at the end.
    pub(crate) fn place(&self, seconds: f64) -> (usize, f32) {
        let last = self.frames().saturating_sub(1);
        let place = (seconds * self.fps).clamp(0.0, last as f64);
        // Tolerates rounding in the division by the frame rate.
        let is_frame = (place - place.round()).abs() < 1e-6;
        let place = if is_frame { place.round() } else { place };
        (place.floor() as usize, (place - place.floor()) as f32)
    }

    /// The pose at a time, interpolated between frames, clamped at both ends.
    pub(crate) fn pose(&self, seconds: f64) -> Pose {
        let (from, part) = self.place(seconds);
        let to = (from + 1).min(self.frames().saturating_sub(1));
        let between = |a: f32, b: f32| if part > 0.0 { a + part * (b - a) } else { a };
        let joints = (0..self.joints()).map(|joint| {
            let (a, b) = (self.joint(from, joint), self.joint(to, joint));
            [0, 1, 2].map(|axis| between(a[axis], b[axis]))
        });
        let orientation = self.orientations.as_ref().map(|turns| {
            let (a, b) = (turns[from], turns[to]);
            let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            let sign = if dot < 0.0 { -1.0 } else { 1.0 };
            normalised([0, 1, 2, 3].map(|axis| between(a[axis], sign * b[axis])))
        });
        Pose {
            joints: joints.collect(),
            orientation,
        }
    }

    /// The side of a joint, by its name.
    pub(crate) fn side(&self, joint: usize) -> Side {
        let name = self.joint_names.get(joint).map_or("", String::as_str);
        let name = name.rsplit(':').next().unwrap_or(name);
        let lower = name.to_lowercase();
        let of = |word: &str, letter: char| {
            let second = name.chars().nth(1).unwrap_or(' ');
            let is_camel = second.is_uppercase() && name != name.to_uppercase();
            let initial = lower.starts_with(letter) && (is_camel || "_.-".contains(second));
            let end = ["_", ".", "-"].map(|mark| format!("{mark}{letter}"));
            lower.contains(word) || initial || end.iter().any(|end| lower.ends_with(end))
        };
        match (of("left", 'l'), of("right", 'r')) {
            (true, false) => Side::Left,
            (false, true) => Side::Right,
            _ => Side::Middle,
        }
    }
}

/// The normalized quaternion (w, x, y, z); the identity for zeros.
pub(crate) fn normalised(q: [f32; 4]) -> [f32; 4] {
    let norm = q.iter().map(|part| part * part).sum::<f32>().sqrt();
    match norm.is_finite() && norm > 1e-12 {
        true => q.map(|part| part / norm),
        false => [1.0, 0.0, 0.0, 0.0],
    }
}

/// The bounding box of points; zeros without any.
pub(crate) fn bounds<const N: usize>(points: &[[f32; N]]) -> [[f32; N]; 2] {
    [f32::min, f32::max].map(|extreme: fn(f32, f32) -> f32| {
        let points = points.iter().copied();
        let found = points.reduce(|a, b| std::array::from_fn(|axis| extreme(a[axis], b[axis])));
        found.unwrap_or([0.0; N])
    })
}

/// The cross product.
pub(crate) fn cross<T>(a: [T; 3], b: [T; 3]) -> [T; 3]
where
    T: Copy + Mul<Output = T> + Sub<Output = T>,
{
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| a[i] * b[j] - a[j] * b[i])
}

/// The vector rotated by a unit quaternion (w, x, y, z).
pub(crate) fn rotate([w, x, y, z]: [f32; 4], v: [f32; 3]) -> [f32; 3] {
    let axis = [x, y, z];
    let once = cross(axis, v);
    let twice = cross(axis, once);
    [0, 1, 2].map(|i| v[i] + 2.0 * (w * once[i] + twice[i]))
}

#[cfg(test)]
pub(crate) mod tests;
