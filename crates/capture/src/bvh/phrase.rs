//! Phrases, and other lone roots, as BVH.

use kinegrad_motion::phrase::POSITION;
use kinegrad_motion::{FPS, Phrase, Quaternion};

use super::{Bvh, Joint};
use crate::Error;
use crate::error::require_positive;

/// End of the bone of a lone root, metres. The end is in front of the root, so that programs that
/// draw bones show the heading.
const FRONT: [f64; 3] = [0.0, 0.0, 0.3];

impl Bvh {
    /// Place and orientation of a phrase as a file of one joint, `root`, at 30 frames per second,
    /// with `units_per_metre`: 100 for centimetres. [`root_track`](Self::root_track) with the
    /// inverse scale reads the file back.
    ///
    /// # Errors
    /// [`Error::Setting`] if `units_per_metre` is not positive or the phrase is not finite.
    pub fn from_phrase(phrase: &Phrase, units_per_metre: f64) -> Result<Self, Error> {
        let frames = 0..phrase.frames();
        let positions: Vec<[f64; 3]> = frames.clone().map(|t| phrase.vector(t, POSITION)).collect();
        let turns: Vec<Quaternion> = frames.map(|t| phrase.quaternion(t)).collect();
        Self::from_root(&positions, &turns, FPS, units_per_metre)
    }

    /// [`from_phrase`](Self::from_phrase) of `positions` `[frames, 3]` in metres, +y up, and
    /// `orientations` `[frames]` at `fps` frames per second.
    ///
    /// # Errors
    /// [`Error::Setting`] also for no frames, lists of different length, and a rate that is not positive.
    pub fn from_root(
        positions: &[[f64; 3]],
        orientations: &[Quaternion],
        fps: f64,
        units_per_metre: f64,
    ) -> Result<Self, Error> {
        let allowed = "a positive number: 1 for metres, 100 for centimetres";
        require_positive("units_per_metre", units_per_metre, allowed)?;
        require_positive("fps", fps, "a positive number of frames per second")?;
        let front = FRONT.map(|value| value * units_per_metre);
        let root = Joint::new("root".to_string(), None, [0.0; 3], Some(front));
        let scaled = |place: &[f64; 3]| place.map(|value| value * units_per_metre);
        let places: Vec<[f64; 3]> = positions.iter().map(scaled).collect();
        Self::from_rotations(&[root], 1.0 / fps, &places, orientations)
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_data::synthetic;

    use super::*;
    use crate::{RootSource, UpAxis};

    #[test]
    fn a_written_phrase_is_read_back_by_the_reader_of_plans() {
        let phrase = synthetic::phrase(3, 150, 1).motion;
        for scale in [1.0, 100.0] {
            let text = Bvh::from_phrase(&phrase, scale).unwrap().to_text();
            let read = Bvh::parse(text.as_bytes(), "phrase.bvh").unwrap();
            let track = read.root_track(1.0 / scale, UpAxis::Y).unwrap();
            // The rate is exactly that of phrases: nothing is resampled.
            assert_eq!((track.frames(), track.rate()), (150, FPS));
            for t in 0..150 {
                let pose = track.pose(t).unwrap();
                let known = phrase.vector(t, POSITION);
                let apart = |axis: usize| (pose.position[axis] - known[axis]).abs();
                assert!((0..3).all(|axis| apart(axis) < 1e-6), "frame {t}");
                let dot = pose.orientation.dot(phrase.quaternion(t).normalised());
                assert!(1.0 - dot.abs() < 1e-9, "frame {t}");
            }
        }
    }

    #[test]
    fn values_that_cannot_be_written_are_named() {
        let phrase = synthetic::phrase(3, 4, 1).motion;
        let error = Bvh::from_phrase(&phrase, -1.0).unwrap_err().to_string();
        assert!(error.contains("`units_per_metre` is -1"), "{error}");
        let mut broken = phrase.clone();
        broken.frame_mut(2)[1] = f32::NAN;
        let error = Bvh::from_phrase(&broken, 1.0).unwrap_err().to_string();
        assert!(error.contains("`root`"), "{error}");
        let turns = [Quaternion::IDENTITY];
        assert!(Bvh::from_root(&[[0.0; 3]], &turns, 0.0, 1.0).is_err());
        assert!(Bvh::from_root(&[], &[], 30.0, 1.0).is_err());
    }
}
