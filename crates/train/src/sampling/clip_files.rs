//! The files of a clip of joint features.

use kinegrad_motion::humanml::{Features, Joints, Skeleton};

use super::Contents;

/// Extension of joint positions, or of a path alone.
pub const MOTION: &str = ".npy";

/// Extension of joint features.
pub const FEATURES: &str = ".features.npy";

/// Extension of the animated skeleton.
pub const BVH: &str = ".bvh";

/// Joint positions `[T, J, 3]`, features and the animated skeleton of a clip, whose `joints` may be
/// elsewhere on the ground than its features say.
pub fn clip_files(
    features: Features,
    joints: Joints,
    skeleton: &Skeleton,
) -> Vec<(&'static str, Contents)> {
    let positions = Contents::Array {
        shape: vec![joints.frames(), joints.joints(), 3],
        values: joints.to_f32(),
    };
    let rows = Contents::Array {
        shape: vec![features.frames(), features.layout().channels()],
        values: features.into_vec(),
    };
    let figure = Contents::Figure {
        joints,
        skeleton: Box::new(skeleton.clone()),
    };
    vec![(MOTION, positions), (FEATURES, rows), (BVH, figure)]
}
