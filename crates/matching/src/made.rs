//! The result of a job and its measures.

use kinegrad_capture::Bvh;

use crate::{
    Adaptation, Frames, Looping, Measures, MotionMatrix, Novelty, Part, Quality, Run, Seam,
    Settings, Sliding, Synthesis,
};

/// A new motion and its sources.
#[derive(Clone, Debug)]
pub struct Made {
    /// The motion, with the hierarchy of the first example.
    pub bvh: Bvh,
    /// The settings that it was made with.
    pub settings: Settings,
    /// Replacement of the settings by those that were found to be needed, if any.
    pub adaptation: Option<Adaptation>,
    /// Its physical measures beside those of the examples.
    pub quality: Quality,
    /// Its matrix and origins, before feet are locked.
    pub synthesis: Synthesis,
    /// The layout of the matrices.
    pub layout: MotionMatrix,
    /// The matrices of the examples.
    pub examples: Vec<Frames>,
    /// The matched parts, one for each list of origins.
    pub parts: Vec<Part>,
    /// Foot sliding, if feet are locked.
    pub sliding: Option<Sliding>,
    /// With fixed parts: the 95th percentile of jerk, relative to that of the source motions.
    pub jerk: Option<f64>,
}

impl Made {
    /// Measures over the rotations of `joints`, by index; an empty list stands for all joints.
    pub fn measures(&self, joints: &[usize]) -> Option<Measures> {
        let (motion, examples) = self.rotations(joints);
        Measures::of(&motion, &examples)
    }

    /// Novelty of each part.
    pub fn novelty(&self) -> Vec<Novelty> {
        let of = |origins: &Vec<(usize, usize)>| Novelty::of(origins, self.layout.frame_time());
        self.synthesis.origins.iter().map(of).collect()
    }

    /// Runs of frames that follow an example, for each part.
    pub fn runs(&self) -> Vec<Vec<Run>> {
        let origins = self.synthesis.origins.iter();
        origins.map(|origins| Run::all(origins)).collect()
    }

    /// The seam of a loop; `None` for other motions.
    pub fn seam(&self, looping: Looping) -> Option<Seam> {
        let is_loop = looping != Looping::Off;
        is_loop.then(|| Seam::of(&self.layout, &self.bvh)).flatten()
    }

    /// Rotations of `joints` in the motion and the examples; an empty list stands for all joints.
    fn rotations(&self, joints: &[usize]) -> (Frames, Vec<Frames>) {
        let all: Vec<usize> = (0..self.layout.joints().len()).collect();
        let joints = if joints.is_empty() { &all } else { joints };
        let rotation = |&joint: &usize| self.layout.rotation_of(joint);
        let channels: Vec<usize> = joints.iter().flat_map(rotation).collect();
        let examples = self.examples.iter().map(|each| each.columns(&channels));
        (self.synthesis.frames.columns(&channels), examples.collect())
    }
}
