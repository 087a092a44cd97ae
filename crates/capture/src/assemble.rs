//! Placing segments of takes on the timeline of a song.

use std::ops::Range;

use kinegrad_motion::FPS;

use crate::error::{require, require_positive};
use crate::{Error, RootSource, RootTrack};

/// Largest difference of equal times, seconds: sums of durations are rounded.
const SAME_TIME: f64 = 1e-6;

/// A part of a take, stretched evenly to its time in the music.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Index of the take.
    pub take: usize,
    /// Fractional frames of the take, counted from 0: played from the first to just before the
    /// last.
    pub capture_frames: Range<f64>,
    /// Seconds from the beginning of the music to the segment.
    pub start_seconds: f64,
    /// Length in seconds of music, positive.
    pub seconds: f64,
}

impl Segment {
    fn end_seconds(&self) -> f64 {
        self.start_seconds + self.seconds
    }
}

/// A root track at 30 frames per second and the source of each frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Assembly {
    /// The track. Frame `t` is at `t / 30` seconds of music; frames that no segment covers or
    /// whose capture is missing are not valid.
    pub track: RootTrack,
    /// The moment of a take that each frame shows, `[frames]`; none outside the segments.
    pub moments: Vec<Option<Moment>>,
}

/// A moment of a take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Index of the segment that plays the moment.
    pub segment: usize,
    /// Index of the take.
    pub take: usize,
    /// Seconds from the take's beginning.
    pub seconds: f64,
}

/// Plays `segments`, in order of time, of `takes` on a timeline of `frames` frames at 30 per
/// second. The coordinates are those of the capture; [`super::join`] removes the jumps. A frame on
/// the border of two segments belongs to the later one.
///
/// # Errors
/// [`Error::Setting`] for a take that does not exist, numbers that are not finite, lengths that are
/// not positive, overlapping segments, and no frames.
pub fn assemble(
    takes: &[&dyn RootSource],
    segments: &[Segment],
    frames: usize,
) -> Result<Assembly, Error> {
    check(takes, segments)?;
    let play = |t: usize| match playing(segments, t as f64 / FPS) {
        None => (None, None),
        Some(index) => {
            let segment = &segments[index];
            let take = takes[segment.take];
            let done = (t as f64 / FPS - segment.start_seconds) / segment.seconds;
            let Range { start, end } = segment.capture_frames;
            let capture_frame = start + done.clamp(0.0, 1.0) * (end - start);
            let moment = Moment {
                segment: index,
                take: segment.take,
                seconds: capture_frame / take.rate(),
            };
            (take.sample(capture_frame), Some(moment))
        }
    };
    let (poses, moments) = (0..frames).map(play).unzip();
    Ok(Assembly {
        track: RootTrack::from_poses(poses, FPS)?,
        moments,
    })
}

/// The segment that plays at a moment.
fn playing(segments: &[Segment], seconds: f64) -> Option<usize> {
    let started = segments.partition_point(|s| s.start_seconds <= seconds + SAME_TIME);
    let index = started.checked_sub(1)?;
    (seconds < segments[index].end_seconds() - SAME_TIME).then_some(index)
}

fn check(takes: &[&dyn RootSource], segments: &[Segment]) -> Result<(), Error> {
    let mut end_of_last = f64::NEG_INFINITY;
    for (index, segment) in segments.iter().enumerate() {
        let key = |field: &str| format!("segment[{index}].{field}");
        let found = format!("{} of {} takes", segment.take, takes.len());
        let allowed = "the index of a take, counted from 0";
        require(segment.take < takes.len(), key("take"), found, allowed)?;
        let Range { start, end } = segment.capture_frames;
        let sound = start.is_finite() && end.is_finite() && start <= end;
        let allowed = "two frame numbers, the first not larger";
        let found = format!("{start} to {end}");
        require(sound, key("capture_frames"), found, allowed)?;
        let seconds = segment.seconds;
        require_positive(key("seconds"), seconds, "a positive number of seconds")?;
        let start = segment.start_seconds;
        let follows = start >= end_of_last - SAME_TIME && start.is_finite();
        let found = format!("{start} while the one before ends at {end_of_last}");
        let allowed = "a moment at or after the end of the segment before";
        require(follows, key("start_seconds"), found, allowed)?;
        end_of_last = segment.end_seconds();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinegrad_motion::Quaternion;

    /// x is the frame number.
    fn counting(frames: usize, rate: f64) -> RootTrack {
        let positions = (0..frames).map(|t| [t as f64, 1.0, 0.0]).collect();
        RootTrack::new(positions, vec![Quaternion::IDENTITY; frames], rate).unwrap()
    }

    fn segment(capture_frames: Range<f64>, start_seconds: f64, seconds: f64) -> Segment {
        Segment {
            take: 0,
            capture_frames,
            start_seconds,
            seconds,
        }
    }

    #[test]
    fn a_piece_is_stretched_to_its_length_in_music() {
        let take = counting(100, 80.0);
        let plan = [segment(10.5..50.5, 0.1, 0.4)];
        let assembly = assemble(&[&take], &plan, 20).unwrap();
        for t in 0..20 {
            let pose = assembly.track.pose(t);
            assert_eq!(pose.is_some(), (3..15).contains(&t), "{t}");
            let moment = assembly.moments[t];
            assert_eq!(moment.is_some(), pose.is_some());
            if let Some(pose) = pose {
                let expected = 10.5 + (t as f64 / FPS - 0.1) / 0.4 * 40.0;
                assert!((pose.position[0] - expected).abs() < 1e-9);
                assert!((moment.unwrap().seconds - expected / 80.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn rounding_leaves_no_hole_between_pieces() {
        let take = counting(200, 30.0);
        // An end of 0.1 + 0.2 differs from 0.3.
        let plan: Vec<Segment> = (0..30)
            .map(|k| segment(0.0..3.0, f64::from(k) * 0.1, 0.1))
            .collect();
        let assembly = assemble(&[&take], &plan, 90).unwrap();
        for (t, moment) in assembly.moments.iter().enumerate() {
            assert_eq!(moment.unwrap().segment, t / 3);
        }
        assert!(assembly.track.valid.iter().all(|valid| *valid));
    }

    #[test]
    fn frames_that_the_capture_lacks_are_not_valid() {
        let assembly =
            assemble(&[&counting(10, 30.0)], &[segment(5.0..20.0, 0.0, 0.5)], 15).unwrap();
        let valid: Vec<bool> = (0..15).map(|t| t < 5).collect();
        assert_eq!(assembly.track.valid, valid);
        assert!(
            assembly
                .moments
                .iter()
                .all(|moment| moment.unwrap().take == 0)
        );
    }

    #[test]
    fn plans_that_make_no_sense_are_refused() {
        let take = counting(10, 30.0);
        let good = segment(0.0..5.0, 1.0, 1.0);
        let bad = [
            (
                "take",
                Segment {
                    take: 1,
                    ..good.clone()
                },
            ),
            ("capture_frames", segment(5.0..4.0, 2.0, 1.0)),
            ("capture_frames", segment(0.0..f64::NAN, 2.0, 1.0)),
            ("seconds", segment(0.0..5.0, 2.0, 0.0)),
            ("seconds", segment(0.0..5.0, 2.0, f64::INFINITY)),
            ("start_seconds", segment(0.0..5.0, 1.9, 1.0)),
            ("start_seconds", segment(0.0..5.0, f64::NAN, 1.0)),
        ];
        for (expected, wrong) in bad {
            let error = assemble(&[&take], &[good.clone(), wrong], 90).unwrap_err();
            let Error::Setting(refused) = error else {
                panic!("{error:?}");
            };
            assert_eq!(refused.key, format!("segment[1].{expected}"));
        }
    }
}
