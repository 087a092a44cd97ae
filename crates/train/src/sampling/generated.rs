//! Generated motion and its files.

use kinegrad_motion::CHANNELS;
use kinegrad_motion::Phrase;
use kinegrad_motion::humanml::{Features, Joints, Skeleton};

use super::Contents;

// Extensions of the motion (a phrase, joint positions or a ground path), of a phrase before
// post-processing, of joint features, of the animated skeleton and of the path of a first stage.
const MOTION: &str = ".npy";
const RAW: &str = ".raw.npy";
pub(super) const FEATURES: &str = ".features.npy";
pub(super) const BVH: &str = ".bvh";
const PATH: &str = ".path.npy";

/// Generated motion.
#[derive(Clone, Debug)]
pub enum Generated {
    /// A phrase, `[T, 25]`.
    Phrase {
        /// Post-processed.
        motion: Phrase,
        /// The raw model output.
        raw: Phrase,
    },
    /// A clip of a body.
    Clip {
        /// Joint positions; their ground position may differ from that of the features.
        joints: Joints,
        /// Its skeleton.
        skeleton: Box<Skeleton>,
        /// Joint features, for models that generate them.
        features: Option<Features>,
        /// The ground path of a first stage, x and z in meters.
        path: Option<Vec<[f64; 2]>>,
    },
    /// A ground path, x and z in meters.
    Ground(Vec<[f64; 2]>),
    /// Rows of numbers of another representation.
    Rows {
        /// Shape.
        shape: Vec<usize>,
        /// Values, row-major.
        values: Vec<f32>,
    },
}

impl Generated {
    /// Extensions of the files of a phrase.
    pub const PHRASE: &[&str] = &[MOTION, RAW];
    /// Extensions of the files of joint positions.
    pub const JOINTS: &[&str] = &[MOTION, BVH];
    /// Extensions of the files of a clip.
    pub const CLIP: &[&str] = &[MOTION, FEATURES, BVH];
    /// Extensions of the files of a clip from two stages.
    pub const CLIP_OF_STAGES: &[&str] = &[MOTION, FEATURES, BVH, PATH];
    /// Extensions of the files of rows and ground paths.
    pub const ROWS: &[&str] = &[MOTION];

    /// Its files by extension, the motion first.
    pub fn files(self) -> Vec<(&'static str, Contents)> {
        match self {
            Self::Phrase { motion, raw } => {
                let array = |motion: Phrase| Contents::Array {
                    shape: vec![motion.frames(), CHANNELS],
                    values: motion.into_vec(),
                };
                vec![(MOTION, array(motion)), (RAW, array(raw))]
            }
            Self::Clip {
                joints,
                skeleton,
                features,
                path,
            } => {
                let positions = Contents::Array {
                    shape: vec![joints.frames(), joints.joints(), 3],
                    values: joints.to_f32(),
                };
                let rows = features.map(|features| Contents::Array {
                    shape: vec![features.frames(), features.layout().channels()],
                    values: features.into_vec(),
                });
                let figure = Contents::Body { joints, skeleton };
                let mut files = vec![(MOTION, positions)];
                files.extend(rows.map(|rows| (FEATURES, rows)));
                files.push((BVH, figure));
                files.extend(path.map(|path| (PATH, ground(&path))));
                files
            }
            Self::Ground(path) => vec![(MOTION, ground(&path))],
            Self::Rows { shape, values } => vec![(MOTION, Contents::Array { shape, values })],
        }
    }
}

/// `[frames, 2]`, x and z.
fn ground(path: &[[f64; 2]]) -> Contents {
    Contents::Array {
        shape: vec![path.len(), 2],
        values: path.iter().flatten().map(|&value| value as f32).collect(),
    }
}
