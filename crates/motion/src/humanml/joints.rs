//! Joint positions over time.

use serde::{Deserialize, Serialize};

use super::{FeatureError, Skeleton};

/// Positions of all joints, `[frames, J, 3]`, metres, +y up, in double precision and finite.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Joints {
    values: Vec<[f64; 3]>,
    joints: usize,
}

impl Joints {
    /// Positions `[frames, joints, 3]`, row by row.
    ///
    /// # Errors
    /// [`FeatureError::NotWholeFrames`]; [`FeatureError::NonFinite`] if a coordinate is not finite.
    pub fn new(values: Vec<[f64; 3]>, joints: usize) -> Result<Self, FeatureError> {
        if values.is_empty() || joints == 0 || !values.len().is_multiple_of(joints) {
            return Err(FeatureError::NotWholeFrames {
                what: "joints",
                values: values.len(),
                width: joints,
            });
        }
        let bad = |place: &[f64; 3]| !place.iter().all(|value| value.is_finite());
        if let Some(index) = values.iter().position(bad) {
            return Err(FeatureError::NonFinite {
                what: "joints",
                frame: index / joints,
                entry: format!("joint {}", index % joints),
            });
        }
        Ok(Self { values, joints })
    }

    /// Positions from single precision, `[frames, joints, 3]` row by row.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn from_f32(values: &[f32], joints: usize) -> Result<Self, FeatureError> {
        let (places, rest) = values.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(FeatureError::NotWholeFrames {
                what: "joints",
                values: values.len(),
                width: 3 * joints,
            });
        }
        let places = places.iter().map(|place| place.map(f64::from));
        Self::new(places.collect(), joints)
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.values.len() / self.joints
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// The joints of frame `t`, `[J, 3]`.
    pub fn frame(&self, t: usize) -> &[[f64; 3]] {
        &self.values[t * self.joints..(t + 1) * self.joints]
    }

    /// Positions of one joint, `[frames, 3]`.
    pub fn track(&self, joint: usize) -> Vec<[f64; 3]> {
        (0..self.frames()).map(|t| self.frame(t)[joint]).collect()
    }

    /// All positions, `[frames, J, 3]` row by row.
    pub fn as_slice(&self) -> &[[f64; 3]] {
        &self.values
    }

    /// All positions in single precision, `[frames, J, 3]` row by row.
    pub fn to_f32(&self) -> Vec<f32> {
        let values = self.values.iter().flatten();
        values.map(|value| *value as f32).collect()
    }

    /// Positions that are finite whole frames by construction.
    pub(super) fn computed(values: Vec<[f64; 3]>, joints: usize) -> Self {
        debug_assert!(values.len().is_multiple_of(joints));
        Self { values, joints }
    }

    /// Rejects joints of another skeleton.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for another number of joints.
    pub fn must_be_of(&self, skeleton: &Skeleton) -> Result<(), FeatureError> {
        FeatureError::unless_equal("joints of a frame", skeleton.joints(), self.joints)
    }

    /// The clip reflected at the plane x = 0: paired joints are swapped and x is negated.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for joints of another skeleton.
    pub fn mirror(&self, skeleton: &Skeleton) -> Result<Self, FeatureError> {
        self.must_be_of(skeleton)?;
        let mirrored = skeleton.mirrored();
        let values = (0..self.frames()).flat_map(|t| {
            let places = mirrored.iter().map(move |&joint| self.frame(t)[joint]);
            places.map(|[x, y, z]| [-x, y, z])
        });
        Ok(Self {
            values: values.collect(),
            joints: self.joints,
        })
    }
}
