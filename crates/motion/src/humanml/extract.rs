//! From joints to features.
//!
//! Source: HumanML3D (docs/sources.md, section 3.3).

use kinegrad_settings::{Refused, in_range};
use serde::{Deserialize, Serialize};

use super::bone_rotations::{
    Across, Heading, forward, forward_kinematics, inverse_kinematics, to_columns,
};
use super::{FeatureError, Features, Joints, Root, Skeleton};
use crate::Quaternion;
use crate::rotation::between;
use crate::vector::{minus, plus};

/// Settings of the extraction of features from joints.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Extraction {
    /// [Rescale](rescale) every clip to the reference bones, as in the published dataset.
    pub rescale: bool,
    /// A foot joint is in contact if the squared displacement to the next frame is below this
    /// threshold, square metres. The published 0.002 is 4.5 cm per frame, without a height test.
    pub contact_threshold: f64,
    /// Heading of the root; published features use the smoothed heading.
    pub heading: Heading,
}

impl Default for Extraction {
    fn default() -> Self {
        Self {
            rescale: true,
            contact_threshold: 0.002,
            heading: Heading::default(),
        }
    }
}

impl Extraction {
    /// The features of a clip, with relative root: T frames give T - 1 rows. The clip is
    /// [canonicalized](canonicalize), and rescaled if `rescale` is set.
    ///
    /// # Errors
    /// [`FeatureError::Setting`] for an invalid contact threshold; other errors about the joints.
    pub fn features(&self, skeleton: &Skeleton, joints: &Joints) -> Result<Features, FeatureError> {
        let joints = match self.rescale {
            true => &rescale(skeleton, joints)?,
            false => joints,
        };
        self.features_in_place(skeleton, &canonicalize(skeleton, joints)?)
    }

    /// [`features`](Self::features) with one row per frame: the last step is repeated.
    ///
    /// # Errors
    /// The errors of [`features`](Self::features).
    pub fn features_of_all_frames(
        &self,
        skeleton: &Skeleton,
        joints: &Joints,
    ) -> Result<Features, FeatureError> {
        self.features(skeleton, &extrapolated(joints)?)
    }

    /// The features of the clip as it is: heights are measured from y = 0, and the first frame
    /// counts as facing +z.
    ///
    /// # Errors
    /// The errors of [`features`](Self::features).
    pub fn features_in_place(
        &self,
        skeleton: &Skeleton,
        joints: &Joints,
    ) -> Result<Features, FeatureError> {
        self.must_be_valid()?;
        joints.must_be_of(skeleton)?;
        if joints.frames() < 2 {
            return Err(FeatureError::TooFewFrames {
                found: joints.frames(),
                needed: 2,
            });
        }
        let rotations = inverse_kinematics(skeleton, joints, self.heading)?;
        let rotations: Vec<&[Quaternion]> = rotations.chunks_exact(skeleton.joints()).collect();
        let layout = skeleton.layout();
        let mut values = Vec::with_capacity((joints.frames() - 1) * layout.channels());
        for t in 0..joints.frames() - 1 {
            let frames = [joints.frame(t), joints.frame(t + 1)];
            values.extend(self.row(skeleton, frames, rotations[t], rotations[t + 1][0]));
        }
        Features::new(values, layout, Root::Relative)
    }

    /// Rejects an invalid contact threshold.
    pub(super) fn must_be_valid(&self) -> Result<(), FeatureError> {
        in_range("contact_threshold", self.contact_threshold, 0.0..)
            .hint("square metres; 0.002 in the published data set")?;
        Ok(())
    }

    /// The features of a frame with `rotations`, and of the step to the next frame.
    pub(super) fn row(
        &self,
        skeleton: &Skeleton,
        [frame, next]: [&[[f64; 3]]; 2],
        rotations: &[Quaternion],
        next_facing: Quaternion,
    ) -> Vec<f32> {
        let facing = rotations[0];
        let steps = next.iter().zip(frame);
        let steps: Vec<[f64; 3]> = steps.map(|(next, here)| minus(*next, *here)).collect();
        let mut values = Vec::with_capacity(skeleton.layout().channels());
        let turn = next_facing * facing.conjugate();
        // The shorter rotation, also where the heading passes the direction opposite to the first
        // frame's. The published script takes the longer rotation there and turns back for a frame.
        let half_turn = turn.y.copysign(turn.y * turn.w);
        let [x, _, z] = next_facing.rotate(steps[0]);
        values.extend([half_turn.clamp(-1.0, 1.0).asin(), x, z, frame[0][1]]);
        values.extend(in_facing_frame(frame, facing).skip(1).flatten());
        values.extend(rotations[1..].iter().flat_map(|q| to_columns(*q)));
        values.extend(steps.iter().flat_map(|step| facing.rotate(*step)));
        values.extend(skeleton.contact_joints().map(|joint| {
            let squared: f64 = steps[joint].iter().map(|value| value * value).sum();
            f64::from(u8::from(squared < self.contact_threshold))
        }));
        values.into_iter().map(|value| value as f32).collect()
    }
}

/// The clip with an extra frame that repeats the last step.
///
/// # Errors
/// [`FeatureError::NonFinite`] if values overflow.
pub fn extrapolated(joints: &Joints) -> Result<Joints, FeatureError> {
    let mut places = joints.as_slice().to_vec();
    let last = joints.frames() - 1;
    let (before, now) = (joints.frame(last.saturating_sub(1)), joints.frame(last));
    let steps = now.iter().zip(before);
    places.extend(steps.map(|(now, before)| plus(*now, minus(*now, *before))));
    Joints::new(places, joints.joints())
}

/// The joints of one frame relative to the root's ground position, rotated by the root quaternion.
pub fn in_facing_frame(frame: &[[f64; 3]], facing: Quaternion) -> impl Iterator<Item = [f64; 3]> {
    let [x, _, z] = frame[0];
    let places = frame.iter();
    places.map(move |place| facing.rotate(minus(*place, [x, 0.0, z])))
}

/// The clip with the reference bones: the same rotations, the root scaled by the leg lengths.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] for joints of another skeleton; [`FeatureError::NoLegs`];
/// [`FeatureError::NonFinite`] if values overflow.
pub fn rescale(skeleton: &Skeleton, joints: &Joints) -> Result<Joints, FeatureError> {
    let rotations = inverse_kinematics(skeleton, joints, Heading::Raw)?;
    let ratio = leg_ratio(skeleton, joints)?;
    let root = |t: usize| joints.frame(t)[0].map(|value| value * ratio);
    let roots: Vec<[f64; 3]> = (0..joints.frames()).map(root).collect();
    forward_kinematics(skeleton, &skeleton.offsets(), &roots, &rotations)
}

/// Ratio of the leg lengths of the skeleton's reference pose to those of a clip's first frame.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] for joints of another skeleton; [`FeatureError::NoLegs`].
pub fn leg_ratio(skeleton: &Skeleton, joints: &Joints) -> Result<f64, FeatureError> {
    joints.must_be_of(skeleton)?;
    let legs = |offsets: &[[f64; 3]]| {
        let largest = |joint: usize| offsets[joint].iter().fold(0.0f64, |a, b| a.max(b.abs()));
        let joints = skeleton.description().leg_joints;
        joints.map(largest).iter().sum::<f64>()
    };
    let source = legs(&skeleton.offsets_of_frame(joints.frame(0)));
    if source == 0.0 {
        return Err(FeatureError::NoLegs);
    }
    Ok(legs(&skeleton.offsets()) / source)
}

/// The clip with the lowest joint at y = 0 and the first root at x = z = 0, facing +z.
///
/// # Errors
/// [`FeatureError::LengthMismatch`]; [`FeatureError::NonFinite`] if values overflow.
pub fn canonicalize(skeleton: &Skeleton, joints: &Joints) -> Result<Joints, FeatureError> {
    joints.must_be_of(skeleton)?;
    let heights = joints.as_slice().iter().map(|[_, y, _]| *y);
    let floor = heights.fold(f64::INFINITY, f64::min);
    let first = joints.frame(0);
    let ([x, _, z], facing) = (first[0], forward(skeleton, first, Across::Consistent));
    let turn = between(facing, [0.0, 0.0, 1.0]);
    let places = joints.as_slice().iter();
    let moved = places.map(|place| turn.rotate(minus(*place, [x, floor, z])));
    Joints::new(moved.collect(), joints.joints())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_that_turns_round_and_round_keeps_its_heading() {
        let skeleton = Skeleton::humanml3d();
        let rest = &skeleton.description().rest_offsets;
        // The body makes 2.5 turns to the left within nine seconds, along +x.
        let (frames, rate) = (180, 0.09);
        let mut places = Vec::new();
        for t in 0..frames {
            let turn = Quaternion::from_yaw(rate * f64::from(t));
            let mut frame = vec![[0.02 * f64::from(t), 0.9, 0.0]; skeleton.joints()];
            for [start, end] in skeleton.chains().flatten() {
                let bone = turn.rotate(rest[end]);
                frame[end] = [0, 1, 2].map(|axis| frame[start][axis] + bone[axis]);
            }
            places.extend(frame);
        }
        let joints = Joints::new(places, skeleton.joints()).unwrap();
        let extraction = Extraction {
            rescale: false,
            ..Extraction::default()
        };
        let features = extraction.features_in_place(&skeleton, &joints).unwrap();
        let back = features.joints();
        let floor = |place: [f64; 3]| [place[0], place[2]];
        for t in 0..back.frames() {
            for (a, b) in back.frame(t).iter().zip(joints.frame(t)) {
                let ([x, z], [u, v]) = (floor(*a), floor(*b));
                assert!((x - u).hypot(z - v) < 1e-3, "frame {t}: {a:?} {b:?}");
            }
        }
    }
}
