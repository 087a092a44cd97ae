//! The next pose as a prediction target.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FeatureError, FeatureLayout};
use crate::Quaternion;
use crate::vector::plus;

/// Representation of the next pose, `[J, 3]` in metres, relative to the current root's ground
/// position and in the current facing frame (docs/sources.md, section 5).
///
/// Feature row t determines frame t + 1, so the history for frame t + 1 ends with row t - 1.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NextPose {
    /// Joint positions.
    #[default]
    Position,
    /// Joint displacements.
    Displacement,
}

impl fmt::Display for NextPose {
    /// The name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl NextPose {
    /// The target of a row of features, `[12 J - 1]` to `[J, 3]`.
    ///
    /// # Errors
    /// [`FeatureError::InvalidChannels`] if no skeleton has this number of channels.
    pub fn of_row(self, row: &[f32]) -> Result<Vec<f32>, FeatureError> {
        let layout = FeatureLayout::of_channels(row.len())?;
        let mut target = row[layout.velocities()].to_vec();
        if self == Self::Position {
            let root = [0.0, row[FeatureLayout::ROOT.end - 1], 0.0];
            let places = root.iter().chain(&row[layout.positions()]);
            for (value, place) in target.iter_mut().zip(places) {
                *value += place;
            }
        }
        Ok(target)
    }

    /// The next frame in the world, `[J, 3]`, from a target, the current `frame` and its root
    /// quaternion `facing` (world to facing frame).
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] unless there are three numbers for each joint.
    pub fn apply(
        self,
        target: &[f32],
        frame: &[[f64; 3]],
        facing: Quaternion,
    ) -> Result<Vec<[f64; 3]>, FeatureError> {
        FeatureError::unless_equal("numbers of a pose", 3 * frame.len(), target.len())?;
        let (targets, _) = target.as_chunks::<3>();
        let to_world = facing.conjugate();
        let [x, _, z] = frame[0];
        let places = targets.iter().zip(frame).map(|(target, place)| {
            let target = to_world.rotate(target.map(f64::from));
            match self {
                Self::Position => plus(target, [x, 0.0, z]),
                Self::Displacement => plus(target, *place),
            }
        });
        Ok(places.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Extraction, FeatureStream, Heading, Skeleton, test_clip};
    use super::*;
    use crate::vector::length;

    #[test]
    fn targets_lead_to_the_next_frame() {
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            let clip = test_clip(&skeleton, 20);
            let extraction = Extraction {
                rescale: false,
                heading: Heading::Raw,
                ..Extraction::default()
            };
            let rows = extraction.features_in_place(&skeleton, &clip).unwrap();
            let mut stream = FeatureStream::new(skeleton, 0.002).unwrap();
            for t in 0..rows.frames() {
                stream.push(clip.frame(t)).unwrap();
                let (frame, facing) = stream.last().unwrap();
                for kind in [NextPose::Position, NextPose::Displacement] {
                    let target = kind.of_row(rows.frame(t)).unwrap();
                    let next = kind.apply(&target, frame, facing).unwrap();
                    for (a, b) in next.iter().zip(clip.frame(t + 1)) {
                        let apart = length([0, 1, 2].map(|i| a[i] - b[i]));
                        assert!(apart < 1e-5, "{kind}, frame {t}: {apart}");
                    }
                }
            }
        }
    }

    #[test]
    fn another_size_is_refused() {
        assert!(NextPose::Position.of_row(&[0.0; 262]).is_err());
        let frame = [[0.0; 3]; 22];
        let error = NextPose::Position.apply(&[0.0; 63], &frame, Quaternion::IDENTITY);
        assert!(error.unwrap_err().to_string().contains("63"));
        let both = [NextPose::Position, NextPose::Displacement]
            .map(|kind| kind.of_row(&[0.5; 263]).unwrap());
        assert_ne!(both[0], both[1]);
    }
}
