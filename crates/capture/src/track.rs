//! The root track over time and its interpolation.

use std::ops::RangeInclusive;

use kinegrad_motion::Quaternion;
use kinegrad_motion::derivatives::make_sign_continuous;

use kinegrad_settings::InvalidSetting;

use crate::Error;
use crate::error::require;

/// Rates of tracks in frames per second. The lower bound limits the length of resampled tracks.
const RATES: RangeInclusive<f64> = 0.1..=100_000.0;

/// Shortest quaternion that has a direction; shorter ones are placeholders.
const SHORTEST: f64 = 1e-6;

/// Place and orientation of a body at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootPose {
    /// Place, `[3]`; metres and +y up in tracks.
    pub position: [f64; 3],
    /// Unit quaternion from body to world; the identity faces +z.
    pub orientation: Quaternion,
}

/// Gaps of one marker.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct MarkerGaps {
    /// The marker's label in the file.
    pub marker: String,
    /// Frames without the marker.
    pub missing_frames: usize,
    /// Missing frames that were filled by a straight line.
    pub filled_frames: usize,
    /// Length of its longest gap in frames.
    pub longest_gap_frames: usize,
}

/// A root over time, between frames too.
pub trait RootSource {
    /// Number of frames, at least 1.
    fn frames(&self) -> usize;

    /// Frames per second.
    fn rate(&self) -> f64;

    /// The root at a fractional frame, counted from 0, in metres and y-up. None outside of the frames
    /// and where a neighbouring frame is not valid.
    fn sample(&self, frame: f64) -> Option<RootPose>;

    /// Gaps of each marker that was not seen throughout.
    fn gaps(&self) -> &[MarkerGaps] {
        &[]
    }
}

/// A root track: metres, +y up, unit quaternions whose sign is continuous in each run of valid
/// frames, with w >= 0 in the first frame of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct RootTrack {
    /// Places, `[frames, 3]`, metres; the origin where not valid.
    pub positions: Vec<[f64; 3]>,
    /// Orientations, `[frames]`; the identity where not valid.
    pub orientations: Vec<Quaternion>,
    /// True for each known frame, `[frames]`.
    pub valid: Vec<bool>,
    rate: f64,
}

impl RootTrack {
    /// A track that is valid throughout: `positions` `[frames, 3]` in metres, `orientations`
    /// `[frames]` of any norm and sign, `rate` in frames per second.
    ///
    /// # Errors
    /// [`Error::Motion`] for arrays of different length, [`Error::Setting`] for no frames or a rate out
    /// of 0.1 to 100000, [`Error::NoPose`] for a frame that is not finite or a quaternion of length 0.
    pub fn new(
        positions: Vec<[f64; 3]>,
        orientations: Vec<Quaternion>,
        rate: f64,
    ) -> Result<Self, Error> {
        if orientations.len() != positions.len() {
            return Err(Error::Motion(kinegrad_motion::Error::LengthMismatch {
                what: "orientations",
                expected: positions.len(),
                found: orientations.len(),
            }));
        }
        let poses = positions.into_iter().zip(orientations);
        let pose = |(position, orientation)| RootPose {
            position,
            orientation,
        };
        Self::from_poses(poses.map(pose).map(Some).collect(), rate)
    }

    /// A track from poses `[frames]`. Frames without a pose are not valid and have the origin with
    /// the identity.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_poses(poses: Vec<Option<RootPose>>, rate: f64) -> Result<Self, Error> {
        const PLACE: &str = "(counted from 0) of the root track";
        check_rate(rate)?;
        let frames = poses.len();
        require(frames > 0, "frames", frames, "at least one")?;
        for (frame, pose) in poses.iter().enumerate() {
            let Some(pose) = pose else { continue };
            let norm = pose.orientation.norm();
            if !(pose.position.iter().all(|value| value.is_finite()) && norm.is_finite()) {
                let hint = "look at this frame in the capture file: a value is far out of range";
                let problem = format!("frame {frame} {PLACE} is not finite");
                return Err(Error::NoPose { problem, hint });
            }
            if norm < SHORTEST {
                let hint = "a frame without a rotation, perhaps one that was not captured: leave it \
                            out, or fill it before";
                let problem = format!("the quaternion of frame {frame} {PLACE} is zero");
                return Err(Error::NoPose { problem, hint });
            }
        }
        let valid: Vec<bool> = poses.iter().map(Option::is_some).collect();
        let pose = |pose: Option<RootPose>| match pose {
            Some(pose) => (pose.position, pose.orientation.normalised()),
            None => ([0.0; 3], Quaternion::IDENTITY),
        };
        let (positions, mut orientations): (Vec<_>, Vec<_>) = poses.into_iter().map(pose).unzip();
        for run in runs(&valid) {
            let first = &mut orientations[run.start];
            if first.w < 0.0 {
                *first = first.scale(-1.0);
            }
            make_sign_continuous(&mut orientations[run]);
        }
        Ok(Self {
            positions,
            orientations,
            valid,
            rate,
        })
    }

    /// The pose of frame `t`, none where it is not valid or beyond the end.
    pub fn pose(&self, t: usize) -> Option<RootPose> {
        self.valid.get(t)?.then(|| RootPose {
            position: self.positions[t],
            orientation: self.orientations[t],
        })
    }

    /// The maximal runs of valid frames, in order.
    pub fn stretches(&self) -> Vec<std::ops::Range<usize>> {
        runs(&self.valid)
    }
}

impl RootSource for RootTrack {
    fn frames(&self) -> usize {
        self.positions.len()
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    /// Linear position, spherical linear rotation.
    fn sample(&self, frame: f64) -> Option<RootPose> {
        let (t, fraction) = split(frame, self.frames())?;
        let from = self.pose(t)?;
        if fraction == 0.0 {
            return Some(from);
        }
        let to = self.pose(t + 1)?;
        Some(RootPose {
            position: lerp(from.position, to.position, fraction),
            orientation: from.orientation.slerp(to.orientation, fraction),
        })
    }
}

/// The same take at another rate: frame `t` is at `t / rate` seconds. Nothing is extrapolated
/// beyond the last frame of the take.
///
/// # Errors
/// [`Error::Setting`] if a rate is out of 0.1 to 100000 frames per second.
pub fn resample(source: &dyn RootSource, rate: f64) -> Result<RootTrack, Error> {
    check_rate(source.rate())?;
    check_rate(rate)?;
    let last = source.frames().saturating_sub(1) as f64;
    // Rounding may put the last moment just beyond the end.
    let frames = (last / source.rate() * rate + 1e-6).floor() as usize + 1;
    let frame = |t: usize| (t as f64 / rate * source.rate()).min(last);
    let poses = (0..frames).map(|t| source.sample(frame(t)));
    RootTrack::from_poses(poses.collect(), rate)
}

fn check_rate(rate: f64) -> Result<(), InvalidSetting> {
    let allowed = "from 0.1 to 100000 frames per second";
    require(RATES.contains(&rate), "rate", rate, allowed)
}

/// Integer and fractional part of a frame number within `frames` frames.
pub(super) fn split(frame: f64, frames: usize) -> Option<(usize, f64)> {
    let last = frames.checked_sub(1)? as f64;
    let inside = (0.0..=last).contains(&frame);
    inside.then(|| (frame as usize, frame.fract()))
}

/// The point between `a` and `b`.
pub(super) fn lerp(a: [f64; 3], b: [f64; 3], fraction: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + fraction * (b[i] - a[i]))
}

/// The maximal runs of frames that are `valid`, in order.
pub(super) fn runs(valid: &[bool]) -> Vec<std::ops::Range<usize>> {
    let mut start = 0;
    let mut runs = Vec::new();
    for run in valid.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        if run[0] {
            runs.push(start..end);
        }
        start = end;
    }
    runs
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use kinegrad_motion::vector::length;

    /// A spin of `speed` radians per second about a fixed axis on a straight path.
    fn spin(speed: f64, seconds: f64) -> RootPose {
        let axis = [0.48, 0.64, 0.6].map(|v| v * speed * seconds);
        RootPose {
            position: [0.3 * seconds, 1.0 - 0.1 * seconds, seconds],
            orientation: Quaternion::from_rotation_vector(axis),
        }
    }

    fn track(speed: f64, rate: f64, frames: usize) -> RootTrack {
        let poses = (0..frames).map(|t| Some(spin(speed, t as f64 / rate)));
        RootTrack::from_poses(poses.collect(), rate).unwrap()
    }

    fn differ(a: RootPose, b: RootPose) -> f64 {
        let apart = [0, 1, 2].map(|i| a.position[i] - b.position[i]);
        let turn = a.orientation * b.orientation.conjugate();
        length(apart).max(length(turn.to_rotation_vector()))
    }

    proptest! {
        #[test]
        fn resampling_keeps_a_steady_spin(
            rate in prop::sample::select(vec![1.0, 23.976, 29.97, 30.0, 60.0, 80.0, 120.0, 240.0]),
            turn in -3.0f64..3.0,
            frames in 1usize..60,
        ) {
            // Less than half a turn a frame, so that the shorter arc is the right one.
            let resampled = resample(&track(turn * rate, rate, frames), 30.0).unwrap();
            let seconds = (frames - 1) as f64 / rate;
            let last = (resampled.frames() - 1) as f64 / 30.0;
            prop_assert!(last <= seconds + 1e-6 && last > seconds - 1.0 / 30.0);
            for t in 0..resampled.frames() {
                let pose = resampled.pose(t).unwrap();
                prop_assert!((pose.orientation.norm() - 1.0).abs() < 1e-12);
                let expected = spin(turn * rate, t as f64 / 30.0);
                prop_assert!(differ(pose, expected) < 1e-5, "{t} {pose:?} {expected:?}");
            }
        }
    }

    #[test]
    fn a_track_at_the_same_rate_stays_as_it_is() {
        let original = track(2.0, 30.0, 50);
        assert_eq!(resample(&original, 30.0).unwrap().frames(), 50);
        for t in 0..50 {
            let pose = resample(&original, 30.0).unwrap().pose(t).unwrap();
            assert!(differ(pose, original.pose(t).unwrap()) < 1e-12);
        }
    }

    #[test]
    fn nothing_is_read_beyond_the_ends_or_beside_a_gap() {
        let mut poses: Vec<_> = (0..6).map(|t| Some(spin(1.0, f64::from(t)))).collect();
        poses[3] = None;
        let track = RootTrack::from_poses(poses, 1.0).unwrap();
        for outside in [-0.1, 5.01, f64::NAN, f64::INFINITY, 2.5, 3.0, 3.5] {
            assert_eq!(track.sample(outside), None, "{outside}");
        }
        for inside in [0.0, 1.5, 2.0, 4.0, 5.0] {
            assert!(track.sample(inside).is_some(), "{inside}");
        }
        assert_eq!(track.stretches(), [0..3, 4..6]);
    }

    #[test]
    fn signs_start_positive_and_stay_continuous() {
        let spins = (0..400).map(|t| spin(3.0, f64::from(t) / 30.0).orientation.scale(-2.0));
        let track = RootTrack::new(vec![[0.0; 3]; 400], spins.collect(), 30.0).unwrap();
        let orientations = &track.orientations;
        assert!(orientations[0].w > 0.0 && orientations.iter().any(|q| q.w < -0.5));
        assert!(
            orientations
                .windows(2)
                .all(|pair| pair[0].dot(pair[1]) > 0.9)
        );
    }

    #[test]
    fn unusable_tracks_are_refused() {
        let one = vec![Quaternion::IDENTITY];
        assert!(RootTrack::new(vec![[0.0; 3]; 2], one.clone(), 30.0).is_err());
        assert!(RootTrack::new(vec![], vec![], 30.0).is_err());
        for rate in [0.0, -30.0, 1e-9, 1e9, f64::NAN] {
            assert!(
                RootTrack::new(vec![[0.0; 3]], one.clone(), rate).is_err(),
                "{rate}"
            );
            assert!(resample(&track(1.0, 30.0, 2), rate).is_err(), "{rate}");
        }
        let error = RootTrack::new(vec![[f64::NAN; 3]], one, 30.0).unwrap_err();
        assert!(error.to_string().starts_with("frame 0 "), "{error}");
    }
}
