//! Joints and features of HumanML3D and its like: 263 numbers a frame for 22 joints, and as many
//! as it takes for any other skeleton.
//!
//! Metres, +y up, frames of the skeleton's own rate, velocities per frame. Root quaternions turn
//! the world to the facing frame and enter the features by half their angle ([`Root`]). Features
//! are stored in single precision; everything is computed in double precision. Source: C. Guo et
//! al., "Generating Diverse and Natural 3D Human Motions from Text" (2022), and GMD, appendix B,
//! both in the reading of the golden README.

mod builtin;
mod error;
pub mod extract;
mod features;
mod joints;
pub mod kinematics;
mod layout;
mod root;
mod skeleton;
mod statistics;
mod validate;

pub use error::FeatureError;
pub use extract::Extraction;
pub use features::Features;
pub use joints::Joints;
pub use kinematics::Heading;
pub use layout::{FeatureChannel, FeatureLayout};
pub use root::Root;
pub use skeleton::{FaceJoints, Feet, Skeleton, SkeletonDescription};
pub use statistics::{FeatureMoments, FeatureStatistics};
