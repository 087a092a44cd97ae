//! Joint positions and features as in HumanML3D: `12 J - 1` channels for J joints, 263 for 22.
//!
//! Units are metres and frames (velocities per frame), with +y up and the skeleton's own frame
//! rate. Published features in millimetres are converted when read. Root quaternions map world to
//! facing frame; the features contain half the angle ([`Root`]). Features are stored in single
//! precision and computed in double. Source: C. Guo et al., "Generating Diverse and Natural 3D
//! Human Motions from Text" (2022), and GMD, appendix B (docs/sources.md, sections 3 and 4.1).
//!
//! ```
//! use kinegrad_motion::humanml::{Extraction, Features, Joints, Root, Skeleton};
//! use kinegrad_motion::{JointFeatures, representation};
//! let skeleton = Skeleton::humanml3d();
//! // Ten frames of a body that walks along +x in the reference pose.
//! let mut places = Vec::new();
//! for t in 0..10 {
//!     let mut frame = vec![[0.1 * t as f64, 0.9, 0.0]; skeleton.joints()];
//!     for [start, end] in skeleton.chains().flatten() {
//!         let offset = skeleton.description().rest_offsets[end];
//!         frame[end] = [0, 1, 2].map(|i| frame[start][i] + offset[i]);
//!     }
//!     places.extend(frame);
//! }
//! let joints = Joints::new(places, skeleton.joints())?;
//! let features = Extraction::default().features(&skeleton, &joints)?;
//! assert_eq!((features.frames(), features.layout().channels()), (9, 263));
//! let kind = JointFeatures { skeleton: skeleton.clone(), root: Root::Relative };
//! let statistics = representation::statistics_of(&kind, [features.as_slice()]).expect("a clip");
//! let seen = statistics.normalize(features.as_slice());
//! let rows = statistics.denormalize(&seen);
//! let back = Features::new(rows, features.layout(), Root::Relative)?.to_absolute().joints();
//! assert!((back.frame(8)[0][0] - 0.8).abs() < 1e-5);
//! # Ok::<(), kinegrad_motion::humanml::FeatureError>(())
//! ```

/// Width of a pooled text feature of CLIP's ViT-B/32, the condition of published models.
pub const TEXT_CHANNELS: usize = 512;

pub mod bone_rotations;
mod builtin;
mod crop;
mod description;
mod error;
pub mod extract;
mod features;
mod joints;
mod layout;
mod next_pose;
mod root;
mod skeleton;
pub mod stream;
pub(crate) mod units;
mod validate;
pub mod walk;

#[cfg(test)]
mod test_clip;
#[cfg(test)]
pub(crate) use test_clip::test_clip;

pub use bone_rotations::Heading;
pub use description::{FaceJoints, Feet, SkeletonDescription};
pub use error::FeatureError;
pub use extract::Extraction;
pub use features::Features;
pub use joints::Joints;
pub use layout::FeatureLayout;
pub use next_pose::NextPose;
pub use root::Root;
pub use skeleton::Skeleton;
pub use stream::FeatureStream;
