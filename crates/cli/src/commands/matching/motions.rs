//! Motions to match: BVH files, and clips of joint features as BVH.

use std::path::Path;

use kinegrad_capture::Bvh;
use kinegrad_matching::Example;
use kinegrad_motion::humanml::{Extraction, Features, Joints, Root, Skeleton};
use kinegrad_motion::{JointFeatures, Representation};
use kinegrad_train::{Error, Systems};

use crate::io::{BvhReading, CENTIMETRES, MotionArray, as_bvh, has_extension, is_bvh, read_bvh};

/// The representation of a clip.
#[derive(Clone, Debug)]
pub struct Clip {
    skeleton: Skeleton,
    root: Root,
}

/// A motion that was read.
pub struct Motion {
    pub example: Example,
    /// `None` for a BVH file.
    pub clip: Option<Clip>,
}

/// True for the path of a clip.
pub fn is_clip(path: &Path) -> bool {
    has_extension(path, "npy")
}

/// Reads a BVH file or a clip. Fails for other files, unreadable files and motions without a
/// skeleton.
pub fn read(systems: Systems<'_>, path: &Path) -> Result<Motion, Error> {
    let file = path.display().to_string();
    if is_clip(path) {
        return read_clip(systems, path, file);
    }
    if !is_bvh(path) {
        let message = format!("{file} is not a .bvh or .npy file");
        let hint = "examples are motions as BVH, or clips of joint features as .npy";
        return Err(Error::usage(message, hint));
    }
    let bvh = read_bvh(path)?;
    Ok(Motion {
        example: Example { file, bvh },
        clip: None,
    })
}

fn read_clip(systems: Systems<'_>, path: &Path, file: String) -> Result<Motion, Error> {
    let array = MotionArray::read(systems, path, &BvhReading::default())?;
    let (joints, skeleton) = array.body()?;
    let bvh = as_bvh(&joints, &skeleton)?;
    let absolute = JointFeatures {
        skeleton: skeleton.clone(),
        root: Root::Absolute,
    };
    let root = match array.representation.name() == absolute.name() {
        true => Root::Absolute,
        false => Root::Relative,
    };
    Ok(Motion {
        example: Example { file, bvh },
        clip: Some(Clip { skeleton, root }),
    })
}

impl Clip {
    /// Joint features of a motion made from clips, one row per frame; the last row repeats the
    /// velocity of the row before.
    pub fn features(&self, bvh: &Bvh) -> Result<Features, Error> {
        let names = self.skeleton.description().joint_names.iter();
        let places = names.map(|name| bvh.joint(name).expect("its joints"));
        let places: Vec<usize> = places.collect();
        let mut joints: Vec<[f64; 3]> = Vec::new();
        for t in 0..bvh.frames() {
            let world = bvh.world(t);
            let own = places.iter().map(|&joint| world[joint].position);
            joints.extend(own.map(|place| place.map(|value| value / CENTIMETRES)));
        }
        let joints = Joints::new(joints, places.len())?;
        let extraction = Extraction {
            rescale: false,
            ..Extraction::default()
        };
        let features = extraction.features_of_all_frames(&self.skeleton, &joints)?;
        Ok(features.with_root(self.root))
    }
}
