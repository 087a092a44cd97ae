//! From a root track to phrases.

use std::ops::Range;

use kinegrad_motion::{FPS, Phrase, Quaternion, derive, style};

use crate::error::require;
use crate::{Error, RootSource, RootTrack};

/// Frames after a phrase that its derivatives use: one for velocity, two for acceleration.
const DERIVATIVE_FRAMES: usize = 2;

/// A run of valid frames at 30 per second with all channels of phrases except the derivatives. Made
/// by [`stretches`].
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// First frame on the track's timeline.
    pub first_frame: usize,
    positions: Vec<[f64; 3]>,
    orientations: Vec<Quaternion>,
    phase: Vec<f64>,
    style: Vec<[f64; 8]>,
}

/// The maximal runs of valid frames of a track at 30 frames per second. `phase` `[frames]` is the
/// phase of the whole track; style is measured over each run ([`style::describe`]).
///
/// # Errors
/// [`Error::Setting`] for a track at another rate, [`Error::Motion`] for a phase of another length.
pub fn stretches(track: &RootTrack, phase: &[f64]) -> Result<Vec<Stretch>, Error> {
    let allowed = "30 frames per second, as of all phrases: resample the track first";
    require(track.rate() == FPS, "rate", track.rate(), allowed)?;
    if phase.len() != track.frames() {
        return Err(Error::Motion(kinegrad_motion::Error::LengthMismatch {
            what: "phase",
            expected: track.frames(),
            found: phase.len(),
        }));
    }
    let of_run = |frames: Range<usize>| {
        let positions = track.positions[frames.clone()].to_vec();
        let orientations = track.orientations[frames.clone()].to_vec();
        Stretch {
            first_frame: frames.start,
            style: style::describe(&positions, &orientations),
            positions,
            orientations,
            phase: phase[frames].to_vec(),
        }
    };
    Ok(track.stretches().into_iter().map(of_run).collect())
}

impl Stretch {
    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.positions.len()
    }

    /// The phrase of `frames` of this stretch, counted from the stretch's first, moved on the floor
    /// to begin at x = z = 0. Derivatives use the frames after the range; at the end of the stretch
    /// the last velocity repeats.
    ///
    /// # Errors
    /// [`Error::Setting`] if the range is empty or reaches beyond the stretch.
    pub fn phrase(&self, frames: Range<usize>) -> Result<Phrase, Error> {
        let within = !frames.is_empty() && frames.end <= self.frames();
        let found = format!("{frames:?} of {}", self.frames());
        let allowed = "at least one frame, all within the stretch";
        require(within, "frames", found, allowed)?;
        let seen = frames.start..(frames.end + DERIVATIVE_FRAMES).min(self.frames());
        let [x0, _, z0] = self.positions[frames.start];
        // Positions are moved before rounding to single precision, which is finest at the origin.
        let positions = self.positions[seen.clone()].iter();
        let positions = positions.map(|[x, y, z]| [x - x0, *y, z - z0]);
        let positions: Vec<[f64; 3]> = positions.collect();
        let (orientations, phase) = (&self.orientations[seen.clone()], &self.phase[seen.clone()]);
        let motion = derive(&positions, orientations, phase, &self.style[seen])?;
        Ok(motion.slice(0..frames.len()))
    }

    /// Start frames of phrases of `length` frames, counted from the first frame of the stretch: one
    /// every `hop` frames from frame `first` on. The frames left at the end are dropped.
    ///
    /// # Errors
    /// [`Error::Setting`] if `length` or `hop` is 0.
    pub fn starts(&self, first: usize, length: usize, hop: usize) -> Result<Vec<usize>, Error> {
        for (key, value) in [("length", length), ("hop", hop)] {
            require(value > 0, key, value, "at least one frame")?;
        }
        let starts = (first..self.frames()).step_by(hop);
        let complete = starts.take_while(|start| length <= self.frames() - start);
        Ok(complete.collect())
    }

    /// The phrases that begin at [`starts`](Self::starts), each after its first frame on the
    /// track's timeline. Fails as `starts` does.
    pub fn phrases(
        &self,
        first: usize,
        length: usize,
        hop: usize,
    ) -> Result<Vec<(usize, Phrase)>, Error> {
        let phrase = |start| {
            Ok((
                self.first_frame + start,
                self.phrase(start..start + length)?,
            ))
        };
        let starts = self.starts(first, length, hop)?;
        starts.into_iter().map(phrase).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RootPose;
    use kinegrad_data::synthetic;
    use kinegrad_motion::derivatives::{acceleration_errors, mean_norm, velocity_errors};
    use kinegrad_motion::phrase::{ACCELERATION, PHASE, POSITION, VELOCITY};

    /// A dancer far from the origin whose frames 40 and 41 are missing.
    fn track() -> RootTrack {
        let dancer = synthetic::phrase(0, 100, 3).motion;
        let pose = |t: usize| {
            let [x, y, z] = dancer.vector(t, POSITION);
            (!(40..42).contains(&t)).then(|| RootPose {
                position: [x + 50.0, y + 1.0, z - 80.0],
                orientation: dancer.quaternion(t),
            })
        };
        RootTrack::from_poses((0..100).map(pose).collect(), FPS).unwrap()
    }

    fn phase() -> Vec<f64> {
        (0..100).map(|t| f64::from(t) / 100.0).collect()
    }

    #[test]
    fn phrases_stay_within_the_valid_runs() {
        let all = stretches(&track(), &phase()).unwrap();
        let places: Vec<_> = all.iter().map(|s| (s.first_frame, s.frames())).collect();
        assert_eq!(places, [(0, 40), (42, 58)]);
        let starts = |first, length, hop| -> Vec<usize> {
            let phrases = all
                .iter()
                .flat_map(|s| s.phrases(first, length, hop).unwrap());
            phrases.map(|(start, _)| start).collect()
        };
        assert_eq!(starts(0, 20, 20), [0, 20, 42, 62]);
        assert_eq!(starts(5, 20, 10), [5, 15, 47, 57, 67, 77]);
        assert_eq!(starts(0, 58, 1), [42]);
        assert_eq!(starts(58, 1, 1), [0; 0]);
    }

    #[test]
    fn a_phrase_starts_at_the_origin_and_its_derivatives_use_later_frames() {
        let all = stretches(&track(), &phase()).unwrap();
        let dancer = synthetic::phrase(0, 100, 3).motion;
        for (start, phrase) in all[1].phrases(0, 20, 15).unwrap() {
            let [x, y, z] = phrase.vector(0, POSITION);
            assert_eq!((x, z), (0.0, 0.0));
            assert!((y - 1.0 - dancer.vector(start, POSITION)[1]).abs() < 1e-6);
            assert_eq!(phrase.frame(7)[PHASE], phase()[start + 7] as f32);
            assert!(mean_norm(&velocity_errors(&phrase)) < 3e-6);
            assert!(mean_norm(&acceleration_errors(&phrase)) < 3e-6);
            if start + 22 <= 100 {
                for (channels, rounding) in [(VELOCITY, 3e-5), (ACCELERATION, 2e-3)] {
                    let known = dancer.vector(start + 19, channels.clone());
                    let found = phrase.vector(19, channels);
                    assert!(
                        (0..3).all(|i| (known[i] - found[i]).abs() < rounding),
                        "{start}"
                    );
                }
            }
        }
    }

    #[test]
    fn wrong_input_is_refused() {
        let slow = RootTrack::new(vec![[0.0; 3]], vec![Quaternion::IDENTITY], 25.0).unwrap();
        assert!(stretches(&slow, &[0.0]).is_err());
        assert!(stretches(&track(), &[0.0]).is_err());
        let all = stretches(&track(), &phase()).unwrap();
        assert!(all[0].phrases(0, 0, 1).is_err());
        assert!(all[0].phrases(0, 1, 0).is_err());
        assert!(all[0].phrase(3..3).is_err());
        assert!(all[0].phrase(30..41).is_err());
    }
}
