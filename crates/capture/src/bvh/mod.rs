//! Biovision hierarchies (BVH): a tree of joints and their channels, frame by frame, as text.
//!
//! Format: "Biovision BVH", M. Meredith and S. Maddock, Motion Capture File Formats Explained
//! (2001), section 2.2, and the variants of exporters: any channel order, position channels on any
//! joint, joints without channels or End Site.

mod convert;
mod deviation;
mod euler;
mod from_joints;
mod parse;
mod phrase;
mod pose;
mod repose;
#[cfg(test)]
mod tests;
mod write;

pub use deviation::Deviation;

/// An axis of the file's coordinate system.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Axis {
    /// x.
    X,
    /// y.
    Y,
    /// z.
    Z,
}

/// The meaning of one number of a frame.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Channel {
    /// A coordinate relative to the parent, in file units. The value replaces the coordinate of the
    /// joint's OFFSET.
    Position(Axis),
    /// A rotation in degrees, intrinsic: `Zrotation Xrotation` is `Rz Rx`.
    Rotation(Axis),
}

/// The channels by their names in the file.
const CHANNELS: [(&str, Channel); 6] = [
    ("Xposition", Channel::Position(Axis::X)),
    ("Yposition", Channel::Position(Axis::Y)),
    ("Zposition", Channel::Position(Axis::Z)),
    ("Xrotation", Channel::Rotation(Axis::X)),
    ("Yrotation", Channel::Rotation(Axis::Y)),
    ("Zrotation", Channel::Rotation(Axis::Z)),
];

/// A joint of the hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name as in the file, with any prefix.
    pub name: String,
    /// Index of the parent, smaller than that of the joint; none for the root.
    pub parent: Option<usize>,
    /// Place within the parent in file units, unless a position channel replaces it.
    pub offset: [f64; 3],
    /// Its channels in the order of the file, at most six.
    pub channels: Vec<Channel>,
    /// Offsets of its End Sites, in file units.
    pub end_sites: Vec<[f64; 3]>,
    /// Place of its first channel within a frame.
    first_channel: usize,
}

/// The name of a joint without its prefix up to a colon, such as `mixamorig:` or `mixamorig7:`.
pub fn bare_name(name: &str) -> &str {
    name.rsplit(':').next().unwrap_or(name)
}

/// A BVH file: the hierarchy and all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Bvh {
    joints: Vec<Joint>,
    frame_time: f64,
    channels: usize,
    values: Vec<f64>,
    /// Number of frames beyond those that the read file declares.
    frames_beyond: usize,
    /// The file's own frame time, if it was read as milliseconds.
    milliseconds: Option<f64>,
}

impl Bvh {
    /// The joints, each after its parent; the root is the first.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Index of the joint of that name, with or without its prefix up to a colon.
    pub fn joint(&self, name: &str) -> Option<usize> {
        let bare = |joint: &Joint| bare_name(&joint.name) == name;
        let exact = self.joints.iter().position(|joint| joint.name == name);
        exact.or_else(|| self.joints.iter().position(bare))
    }

    /// Seconds from one frame to the next.
    pub fn frame_time(&self) -> f64 {
        self.frame_time
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels
    }

    /// Deviations of the file from its format, in words.
    pub fn notes(&self) -> Vec<String> {
        let frames = self.frames();
        let beyond = (self.frames_beyond > 0).then(|| {
            let declared = frames - self.frames_beyond;
            format!("`Frames:` declares {declared}, and {frames} follow: all are read")
        });
        let milliseconds = self.milliseconds.map(|found| {
            format!(
                "`Frame Time:` is {found}: read as milliseconds, {:.3} frames per second",
                1e3 / found
            )
        });
        beyond.into_iter().chain(milliseconds).collect()
    }

    /// The numbers of frame `t`, `[channels]`, in file units and degrees.
    ///
    /// # Panics
    /// Panics if `t` is not a frame.
    pub fn frame(&self, t: usize) -> &[f64] {
        &self.values[t * self.channels..(t + 1) * self.channels]
    }
}
