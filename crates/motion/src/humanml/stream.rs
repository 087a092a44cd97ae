//! Features of a motion in real time.

use super::bone_rotations::{forward_kinematics, inverse_kinematics, raw_root, rotations_of_frame};
use super::{Extraction, FeatureError, Heading, Joints, Skeleton};
use crate::Quaternion;

/// Features frame by frame, equal to [`Extraction::features_in_place`] with [`Heading::Raw`]. The
/// smoothed heading needs 80 future frames and is unavailable in real time.
#[derive(Clone, Debug)]
pub struct FeatureStream {
    skeleton: Skeleton,
    extraction: Extraction,
    /// The last frame and its rotations.
    last: Option<(Vec<[f64; 3]>, Vec<Quaternion>)>,
    frames: usize,
    /// True if the first frame has its own heading.
    own_heading: bool,
}

/// Largest coordinate of a joint, metres.
const FURTHEST: f64 = 1e15;

impl FeatureStream {
    /// An empty stream with this [`Extraction::contact_threshold`].
    ///
    /// # Errors
    /// [`FeatureError::Setting`] for a contact threshold that is negative or not finite.
    pub fn new(skeleton: Skeleton, contact_threshold: f64) -> Result<Self, FeatureError> {
        let extraction = Extraction {
            rescale: false,
            contact_threshold,
            heading: Heading::Raw,
        };
        extraction.must_be_valid()?;
        Ok(Self {
            skeleton,
            extraction,
            last: None,
            frames: 0,
            own_heading: false,
        })
    }

    /// The stream for a motion with any first heading, on which published rotations depend.
    #[must_use]
    pub fn with_own_heading(self) -> Self {
        Self {
            own_heading: true,
            ..self
        }
    }

    /// Adds the next frame, `[J, 3]` in metres; returns the row of the previous frame, `[12 J -
    /// 1]`.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for another number of joints; [`FeatureError::NonFinite`]
    /// if a coordinate is not finite or too large. The stream is then unchanged.
    pub fn push(&mut self, frame: &[[f64; 3]]) -> Result<Option<Vec<f32>>, FeatureError> {
        FeatureError::unless_equal("joints of a frame", self.skeleton.joints(), frame.len())?;
        let not_finite = |what, entry| FeatureError::NonFinite {
            what,
            frame: self.frames,
            entry,
        };
        // Larger coordinates overflow when squared. False for NaN.
        let bad = |place: &[f64; 3]| !place.iter().all(|value| value.abs() <= FURTHEST);
        if let Some(joint) = frame.iter().position(bad) {
            return Err(not_finite("joints", format!("joint {joint}")));
        }
        let root = match &self.last {
            None if !self.own_heading => Quaternion::IDENTITY,
            _ => raw_root(&self.skeleton, frame),
        };
        let row = self.last.as_ref().map(|(last, rotations)| {
            let frames = [&last[..], frame];
            self.extraction.row(&self.skeleton, frames, rotations, root)
        });
        if let Some(row) = &row
            && let Some(channel) = row.iter().position(|value| !value.is_finite())
        {
            let name = self.skeleton.layout().channel_name(channel);
            return Err(not_finite("features", format!("channel `{name}`")));
        }
        let rotations = rotations_of_frame(&self.skeleton, frame, root);
        self.last = Some((frame.to_vec(), rotations));
        self.frames += 1;
        Ok(row)
    }

    /// The last frame, `[J, 3]`, and its root quaternion.
    pub fn last(&self) -> Option<(&[[f64; 3]], Quaternion)> {
        let (last, rotations) = self.last.as_ref()?;
        Some((last, rotations[0]))
    }

    /// Number of frames added.
    pub fn frames(&self) -> usize {
        self.frames
    }
}

/// The frame, `[J, 3]`, with bones `offsets` ([`Skeleton::offsets_of_frame`]) in the frame's
/// directions.
///
/// # Errors
/// [`FeatureError::LengthMismatch`]; [`FeatureError::NonFinite`] if a coordinate is not finite.
pub fn with_bones(
    skeleton: &Skeleton,
    frame: &[[f64; 3]],
    offsets: &[[f64; 3]],
) -> Result<Vec<[f64; 3]>, FeatureError> {
    FeatureError::unless_equal("joints of a frame", skeleton.joints(), frame.len())?;
    let joints = Joints::new(frame.to_vec(), skeleton.joints())?;
    let rotations = inverse_kinematics(skeleton, &joints, Heading::Raw)?;
    let posed = forward_kinematics(skeleton, offsets, &frame[..1], &rotations)?;
    Ok(posed.frame(0).to_vec())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::test_clip;
    use super::*;
    use crate::vector::length;

    fn raw() -> Extraction {
        Extraction {
            rescale: false,
            heading: Heading::Raw,
            ..Extraction::default()
        }
    }

    fn stream(skeleton: &Skeleton) -> FeatureStream {
        FeatureStream::new(skeleton.clone(), raw().contact_threshold).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn every_row_is_that_of_the_whole_clip(
            noise in proptest::collection::vec(-0.05..0.05f64, 22 * 3),
            frames in 2usize..40,
            kit in any::<bool>(),
        ) {
            let skeleton = if kit { Skeleton::kit() } else { Skeleton::humanml3d() };
            let clip = test_clip(&skeleton, frames);
            let places = clip.as_slice().iter().enumerate().map(|(at, place)| {
                let shift = |i: usize| noise[(at * 7 + i) % noise.len()];
                [0, 1, 2].map(|i| place[i] + shift(i))
            });
            let clip = Joints::new(places.collect(), skeleton.joints()).unwrap();
            let clip_features = raw().features_in_place(&skeleton, &clip).unwrap();
            let mut stream = stream(&skeleton);
            for t in 0..frames {
                let row = stream.push(clip.frame(t)).unwrap();
                prop_assert_eq!(row.as_deref(), t.checked_sub(1).map(|t| clip_features.frame(t)));
                prop_assert_eq!(stream.last().unwrap().0, clip.frame(t));
            }
            prop_assert_eq!(stream.frames(), frames);
        }

        #[test]
        fn a_frame_gets_its_bones_and_keeps_their_directions(
            stretch in proptest::collection::vec(0.5..1.5f64, 22),
        ) {
            let skeleton = Skeleton::humanml3d();
            let clip = test_clip(&skeleton, 9);
            let frame = clip.frame(8);
            let offsets = skeleton.offsets_of_frame(clip.frame(0));
            let mut stretched = frame.to_vec();
            for [start, end] in skeleton.chains().flatten() {
                for i in 0..3 {
                    let bone = frame[end][i] - frame[start][i];
                    stretched[end][i] = stretched[start][i] + stretch[end] * bone;
                }
            }
            let back = with_bones(&skeleton, &stretched, &offsets).unwrap();
            for (a, b) in back.iter().zip(frame) {
                prop_assert!(length([0, 1, 2].map(|i| a[i] - b[i])) < 1e-6);
            }
        }
    }

    #[test]
    fn a_motion_may_begin_with_any_heading() {
        let skeleton = Skeleton::humanml3d();
        let clip = test_clip(&skeleton, 12);
        let turn = Quaternion::from_yaw(2.0);
        let turned: Vec<[f64; 3]> = clip.as_slice().iter().map(|p| turn.rotate(*p)).collect();
        let turned = Joints::new(turned, skeleton.joints()).unwrap();
        let rows = |clip: &Joints, mut stream: FeatureStream| -> Vec<f32> {
            let rows = (0..12).filter_map(|t| stream.push(clip.frame(t)).unwrap());
            // All channels except the rotations.
            let rotations = skeleton.layout().rotations();
            let but_rotations =
                |row: Vec<f32>| [&row[..rotations.start], &row[rotations.end..]].concat();
            rows.flat_map(but_rotations).collect()
        };
        let own_heading = || stream(&skeleton).with_own_heading();
        let (found, expected) = (rows(&turned, own_heading()), rows(&clip, own_heading()));
        let apart = |a: &[f32], b: &[f32]| {
            let pairs = a.iter().zip(b);
            pairs.fold(0.0f32, |most, (a, b)| most.max((a - b).abs()))
        };
        assert!(apart(&found, &expected) < 1e-5);
        // Without an own heading, the first row is in another facing frame.
        let facing_z = rows(&turned, stream(&skeleton));
        let (first, rest) = (263 - 126, 263 - 126..);
        assert!(apart(&facing_z[..first], &expected[..first]) > 0.1);
        assert!(apart(&facing_z[rest.clone()], &expected[rest]) < 1e-5);
    }

    #[test]
    fn raw_and_smoothed_heading_are_not_the_same() {
        let skeleton = Skeleton::humanml3d();
        let clip = test_clip(&skeleton, 30);
        let smoothed = Extraction {
            heading: Heading::Smoothed,
            ..raw()
        };
        let [raw, smoothed] = [raw(), smoothed]
            .map(|extraction| extraction.features_in_place(&skeleton, &clip).unwrap());
        assert_ne!(raw, smoothed);
    }

    #[test]
    fn a_bad_frame_is_refused_and_does_not_change_the_stream() {
        let skeleton = Skeleton::humanml3d();
        let clip = test_clip(&skeleton, 3);
        let mut stream = stream(&skeleton);
        let mut untouched = stream.clone();
        for s in [&mut stream, &mut untouched] {
            s.push(clip.frame(0)).unwrap();
        }
        let short = stream.push(&clip.frame(1)[..21]).unwrap_err();
        assert!(matches!(
            short,
            FeatureError::LengthMismatch { found: 21, .. }
        ));
        let mut spoiled = clip.frame(1).to_vec();
        spoiled[5][2] = f64::NAN;
        let error = stream.push(&spoiled).unwrap_err().to_string();
        assert!(
            error.contains("frame 1") && error.contains("joint 5"),
            "{error}"
        );
        spoiled[5][2] = 1e300;
        let error = stream.push(&spoiled).unwrap_err().to_string();
        assert!(error.contains("joint 5"), "{error}");
        // The first frame is checked too, before any row.
        let mut fresh = FeatureStream::new(skeleton.clone(), 0.002).unwrap();
        assert!(fresh.push(&spoiled).is_err());
        fresh.push(clip.frame(0)).unwrap();
        let rows = [stream, untouched].map(|mut s| s.push(clip.frame(1)).unwrap());
        assert_eq!(rows[0], rows[1]);
        assert!(FeatureStream::new(skeleton, -1.0).is_err());
    }
}
