//! Motions to match: BVH files, and clips of joint features as BVH.

use std::path::Path;

use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_matching::{Example, joined};
use kinegrad_motion::humanml::{Extraction, Features, Joints, Root, Skeleton};
use kinegrad_motion::{JointFeatures, Representation};
use kinegrad_settings::counted;
use kinegrad_train::{Error, Systems};

use crate::io::{
    BvhReading, CENTIMETRES, MotionArray, as_bvh, has_extension, is_bvh, read_figures,
    unit_and_axis,
};
use crate::output::unusable;

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
    /// The figures of a file with several; empty for a single one.
    pub figures: Vec<Bvh>,
    /// Length of the unit in metres, and the axis that points up.
    pub unit_and_axis: (f64, UpAxis),
}

impl Motion {
    fn figures(&self) -> usize {
        self.figures.len().max(1)
    }

    /// Refuses another number of figures than that of the `first` example.
    pub fn must_have_figures_of(&self, first: &Self) -> Result<(), Error> {
        let (found, expected) = (self.figures(), first.figures());
        if found == expected {
            return Ok(());
        }
        let (own, other) = (&self.example.file, &first.example.file);
        Err(Error::usage(
            format!("{own} has {}, {other} {expected}", counted(found, "figure")),
            "motions of one number of figures can be matched",
        ))
    }
}

/// True for the path of a clip.
pub fn is_clip(path: &Path) -> bool {
    has_extension(path, "npy")
}

/// Reads a BVH file or a clip. `up`: the axis that points up, if it is known. Fails for other files,
/// unreadable files and motions without a skeleton.
pub fn read(systems: Systems<'_>, path: &Path, up: Option<UpAxis>) -> Result<Motion, Error> {
    let file = path.display().to_string();
    if is_clip(path) {
        return read_clip(systems, path, file);
    }
    if !is_bvh(path) {
        let message = format!("{file} is not a .bvh or .npy file");
        let hint = "examples are motions as BVH, or clips of joint features as .npy";
        return Err(Error::usage(message, hint));
    }
    let mut figures = read_figures(path)?;
    let unit_and_axis = unit_and_axis(&figures[0], None, up);
    let bvh = match figures.len() {
        1 => figures.remove(0),
        _ => joined(&figures, unit_and_axis.1).map_err(unusable)?,
    };
    Ok(Motion {
        example: Example { file, bvh },
        clip: None,
        figures,
        unit_and_axis,
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
        unit_and_axis: unit_and_axis(&bvh, None, None),
        example: Example { file, bvh },
        clip: Some(Clip { skeleton, root }),
        figures: Vec::new(),
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
