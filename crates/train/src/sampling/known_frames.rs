//! Frames of another motion that a sample contains unchanged.

use std::ops::Range;
use std::path::Path;

use kinegrad_data::read_motion;
use kinegrad_motion::derivatives::make_sign_continuous;
use kinegrad_motion::stitch;
use kinegrad_motion::{CHANNELS, Phrase, Quaternion, channel_name};
use kinegrad_settings::counted;

use super::KnownFramesCondition;
use crate::error::Error;

/// Known frames of a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownFrames {
    /// Stored channels, `[frames, 25]`; zeros in unknown frames.
    pub motion: Phrase,
    /// The ranges of known frames.
    pub frames: Vec<Range<usize>>,
}

impl KnownFramesCondition {
    /// The last frames of `motion`, which the sample continues.
    pub fn continued(motion: &Path) -> Self {
        Self {
            motion: motion.to_path_buf(),
            frames: Vec::new(),
            continued: true,
        }
    }

    /// The frames `text` of a phrase: half-open ranges such as `0..30,90..120`.
    ///
    /// # Errors
    /// [`Error::Usage`] if `text` is not a list of ascending ranges.
    pub fn in_place(motion: &Path, text: &str) -> Result<Self, Error> {
        let wrong = |found: &str| {
            Error::usage(
                format!(
                    "option `keep {text}`: `{found}` is not a range of frames after the previous one"
                ),
                "ranges ascend and do not overlap, and their ends do not count: \
                 option `keep 0..30,90..120` keeps the frames 0 to 29 and 90 to 119",
            )
        };
        let mut frames: Vec<[usize; 2]> = Vec::new();
        for part in text.split(',') {
            let ends = part.trim().split_once("..");
            let ends = ends.and_then(|(a, b)| Some([a.parse().ok()?, b.parse().ok()?]));
            let after = frames.last().map_or(0, |last| last[1]);
            let range = ends
                .filter(|[start, end]: &[usize; 2]| start < end && *start >= after)
                .ok_or_else(|| wrong(part))?;
            frames.push(range);
        }
        Ok(Self {
            motion: motion.to_path_buf(),
            frames,
            continued: false,
        })
    }

    /// Reads the frames for a sample of `frames` frames; a continuation takes at most `most_last`
    /// frames.
    ///
    /// # Errors
    /// If the file is not a finite phrase, is too short, or leaves no frame to sample.
    pub fn read(&self, frames: usize, most_last: usize) -> Result<KnownFrames, Error> {
        let phrase = read_motion(&self.motion)?;
        let name = self.motion.display();
        if let Some((frame, channel)) = phrase.first_non_finite() {
            let channel = channel_name(channel);
            return Err(Error::usage(
                format!("{name}: {channel} of frame {frame} is not finite"),
                "give a motion whose numbers are all finite",
            ));
        }
        let ranges = self.frames.iter().map(|[start, end]| *start..*end);
        let (mut of, mut known, mut option) = (0, ranges.collect::<Vec<_>>(), "keep");
        if self.continued {
            let last = phrase.frames().min(most_last.max(1));
            known = std::iter::once(0..last).collect();
            (of, option) = (phrase.frames() - last, "continue_from");
        }
        let end = known.last().map_or(0, |range| range.end);
        if of + end > phrase.frames() || end > frames {
            let (what, has) = match of + end > phrase.frames() {
                true => (name.to_string(), phrase.frames()),
                false => ("the sample".to_string(), frames),
            };
            return Err(Error::usage(
                format!(
                    "option `{option}` reaches to frame {end}, {what} has {}",
                    counted(has, "frame")
                ),
                "keep frames that both have; option `frames` sets the length of the sample",
            ));
        }
        if known.iter().map(Range::len).sum::<usize>() == frames {
            return Err(Error::usage(
                format!("option `{option}` keeps all {frames} frames"),
                "nothing is left to sample: keep fewer frames, or ask for a longer sample (option \
                 `frames`)",
            ));
        }
        let mut motion = Phrase::new(vec![0.0; frames * CHANNELS])?;
        for t in known.iter().cloned().flatten() {
            motion.frame_mut(t).copy_from_slice(phrase.frame(of + t));
        }
        Ok(KnownFrames {
            motion,
            frames: known,
        })
    }
}

impl KnownFrames {
    /// Number of known frames.
    pub fn count(&self) -> usize {
        self.frames.iter().map(Range::len).sum()
    }

    /// The known frames with unit quaternions of continuous sign, `[25, frames]`.
    pub fn known(&self) -> stitch::KnownFrames {
        let mut is_known = vec![false; self.motion.frames()];
        self.frames
            .iter()
            .for_each(|range| is_known[range.clone()].fill(true));
        let mut motion = self.motion.clone();
        let known: Vec<usize> = (0..is_known.len()).filter(|&t| is_known[t]).collect();
        let mut quaternions: Vec<Quaternion> = known
            .iter()
            .map(|&t| motion.quaternion(t).normalised())
            .collect();
        make_sign_continuous(&mut quaternions);
        for (t, quaternion) in known.into_iter().zip(quaternions) {
            motion.set_quaternion(t, quaternion);
        }
        stitch::KnownFrames {
            values: motion.channel_major(),
            is_known,
        }
    }

    /// Writes the known frames into `motion`. All quaternions of `motion` get the sign that fits
    /// the first known frame. A later range gets the opposite sign if `motion` makes another turn
    /// before it.
    pub fn put_into(&self, motion: &mut Phrase) {
        let Some(first) = self.frames.first().map(|range| range.start) else {
            return;
        };
        if motion.quaternion(first).dot(self.motion.quaternion(first)) < 0.0 {
            for t in 0..motion.frames() {
                motion.set_quaternion(t, motion.quaternion(t).scale(-1.0));
            }
        }
        for range in self.frames.iter().cloned() {
            let sampled = motion.quaternion(range.start);
            let turned = sampled.dot(self.motion.quaternion(range.start)) < 0.0;
            for t in range {
                motion.frame_mut(t).copy_from_slice(self.motion.frame(t));
                if turned {
                    motion.set_quaternion(t, motion.quaternion(t).scale(-1.0));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_of_quaternions_goes_on_into_later_ranges() {
        // The known motion faces +z in two ranges. The sampled motion turns once between them.
        let facing = |angle: f64| {
            let mut frame = vec![0.0; CHANNELS];
            let Quaternion { w, x, y, z } = Quaternion::from_yaw(angle);
            frame[9..13].copy_from_slice(&[w, x, y, z].map(|part| part as f32));
            frame
        };
        let motion = |angles: &[f64]| {
            let frames = angles.iter().flat_map(|angle| facing(*angle));
            Phrase::new(frames.collect()).expect("frames")
        };
        let given = KnownFrames {
            motion: motion(&[0.0; 12]),
            frames: vec![0..2, 10..12],
        };
        let turn = |t: usize| std::f64::consts::TAU * (t.clamp(1, 10) - 1) as f64 / 9.0;
        let mut sampled = motion(&(0..12).map(turn).collect::<Vec<f64>>());
        given.put_into(&mut sampled);
        for t in 1..12 {
            assert!(
                sampled.quaternion(t).dot(sampled.quaternion(t - 1)) > 0.9,
                "{t}"
            );
        }
        assert_eq!(sampled.frame(1), given.motion.frame(1));
        assert_eq!(sampled.quaternion(11).w, -1.0);
    }

    #[test]
    fn ranges_ascend() {
        let these = |text: &str| KnownFramesCondition::in_place(Path::new("m.npy"), text);
        let given = these("0..30, 90..120").expect("ranges");
        assert_eq!(given.frames, [[0, 30], [90, 120]]);
        for bad in [
            "",
            "3",
            "5..5",
            "7..3",
            "0..4,3..9",
            "0..4,",
            "a..b",
            "-1..3",
        ] {
            let error = these(bad).expect_err(bad).to_string();
            assert!(
                error.starts_with(&format!("option `keep {bad}`")),
                "{error}"
            );
        }
    }
}
