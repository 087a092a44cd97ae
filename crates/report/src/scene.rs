//! What viewers, animated pictures and files for other programs show: moving figures, what stands on
//! the floor around them, and a song.

/// Figures that move beside one another.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Title of the page.
    pub title: String,
    /// The figures; all start at the same moment.
    pub figures: Vec<Figure>,
    /// Goal of position control, drawn on the floor.
    pub floor: Floor,
    /// Music that is played with the motion.
    pub song: Option<Song>,
}

/// A figure in motion. Metres, +y up.
#[derive(Clone, Debug, Default)]
pub struct Figure {
    /// Its name.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Joint positions, `[frames, joints, 3]`, finite; joint 0 is the root.
    pub positions: Vec<f32>,
    /// Name of each joint.
    pub joint_names: Vec<String>,
    /// The joint that each joint hangs from; as many as joints.
    pub parents: Vec<Option<usize>>,
    /// Orientation of a lone root (w, x, y, z), one per frame: it is shown as an oriented body.
    pub orientations: Option<Vec<[f32; 4]>>,
    /// When feet stand on the ground.
    pub contacts: Vec<Contact>,
    /// Curves over time.
    pub curves: Vec<Curves>,
}

/// When a joint stands on the ground.
#[derive(Clone, Debug)]
pub struct Contact {
    /// The joint.
    pub joint: usize,
    /// Whether it stands there, one value per frame.
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

/// What is drawn on the ground. Points are `[x, z]` in metres.
#[derive(Clone, Debug, Default)]
pub struct Floor {
    /// Path to follow.
    pub path: Vec<[f32; 2]>,
    /// Frame and place of each key frame.
    pub keyframes: Vec<(usize, [f32; 2])>,
    /// Centre and radius of each obstacle.
    pub obstacles: Vec<([f32; 2], f32)>,
    /// Corners of each obstacle that is no disc.
    pub polygons: Vec<Vec<[f32; 2]>>,
}

/// Music that belongs to the motion.
#[derive(Clone, Debug)]
pub struct Song {
    /// Media type of the file, such as `audio/mpeg`.
    pub media_type: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
    /// Second of the song at which the motion starts.
    pub start: f64,
    /// Beats, in seconds of the song.
    pub beats: Vec<f64>,
}

impl Figure {
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

    /// Position of a joint in a frame.
    pub fn joint(&self, frame: usize, joint: usize) -> [f32; 3] {
        let at = 3 * (frame * self.joints() + joint);
        [
            self.positions[at],
            self.positions[at + 1],
            self.positions[at + 2],
        ]
    }
}
