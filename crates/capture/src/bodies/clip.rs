//! From a body to the features of clips.

use std::ops::Range;

use kinegrad_motion::humanml::extract::{canonicalize, rescale};
use kinegrad_motion::humanml::kinematics::minus;
use kinegrad_motion::humanml::{Extraction, FeatureError, Features, Joints, Skeleton};
use kinegrad_motion::rotation::length;

/// Toes that move no further than this from a frame to the next stand, metres.
const STANDING: f64 = 0.01;
/// The fewest frames of standing toes that tell where the floor is.
const ENOUGH: usize = 5;
/// Part of the standing toes that may be below the floor: captures err.
const BELOW: f64 = 0.05;

/// A take whose joints stand on the floor, to cut clips from.
#[derive(Clone, Debug)]
pub struct Grounded {
    /// `[frames, J]`, metres; the floor is y = 0.
    joints: Joints,
}

impl Grounded {
    /// Puts the joints of a take on the floor, which is where its toes stand, with the bones of `skeleton` where `retarget` says
    /// so ([`rescale`]).
    ///
    /// # Errors
    /// As [`rescale`].
    pub fn new(skeleton: &Skeleton, joints: &Joints, retarget: bool) -> Result<Self, FeatureError> {
        let joints = match retarget {
            true => rescale(skeleton, joints)?,
            false => joints.clone(),
        };
        let floor = floor(skeleton, &joints);
        let joints = raised(&joints, -floor)?;
        Ok(Self { joints })
    }

    /// Frames that clips can have: each speaks of a moment and the next.
    pub fn frames(&self) -> usize {
        self.joints.frames() - 1
    }

    /// The features of a part of the take, which begins at x = z = 0 facing +z. Its floor is that
    /// of the whole take, which may not be touched in each part.
    ///
    /// # Errors
    /// As [`Extraction::features_in_place`].
    pub fn clip(
        &self,
        skeleton: &Skeleton,
        frames: Range<usize>,
    ) -> Result<Features, FeatureError> {
        let count = self.joints.joints();
        let part = &self.joints.as_slice()[frames.start * count..(frames.end + 1) * count];
        let part = Joints::new(part.to_vec(), count)?;
        let placed = raised(&canonicalize(skeleton, &part)?, lowest(&part))?;
        Extraction::default().features_in_place(skeleton, &placed)
    }
}

/// The height of the floor: that of the lowest toes that stand, but for a few frames. A take in which
/// nobody stands has its lowest joint on the floor.
fn floor(skeleton: &Skeleton, joints: &Joints) -> f64 {
    let [_, left, _, right] = skeleton.contact_joints();
    let mut standing: Vec<f64> = (1..joints.frames())
        .flat_map(|t| [(t, left), (t, right)])
        .filter(|&(t, toes)| {
            let step = minus(joints.frame(t)[toes], joints.frame(t - 1)[toes]);
            length(step) < STANDING
        })
        .map(|(t, toes)| joints.frame(t)[toes][1])
        .collect();
    if standing.len() < ENOUGH {
        return lowest(joints);
    }
    standing.sort_by(f64::total_cmp);
    standing[(BELOW * standing.len() as f64) as usize]
}

/// The height of the lowest joint.
fn lowest(joints: &Joints) -> f64 {
    let heights = joints.as_slice().iter().map(|[_, y, _]| *y);
    heights.fold(f64::INFINITY, f64::min)
}

/// The joints so much higher.
fn raised(joints: &Joints, by: f64) -> Result<Joints, FeatureError> {
    let places = joints.as_slice().iter().map(|[x, y, z]| [*x, y + by, *z]);
    Joints::new(places.collect(), joints.joints())
}
