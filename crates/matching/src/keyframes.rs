//! Key frames of a new motion, from a TOML file.

use kinegrad_settings::read_toml;
use serde::{Deserialize, Serialize};

use crate::{Constraint, Error, Example, Frames, MotionMatrix, Part};

/// Default reach in seconds.
const REACH: f64 = 0.4;

/// Largest coordinate of a place in file units, for single precision.
const FURTHEST: f64 = 1e6;

/// Largest time in seconds.
const LATEST: f64 = 1e6;

/// A pose of the new motion at a time.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Keyframe {
    /// Time in seconds.
    pub time: f64,
    /// Time of the pose in its source, in seconds.
    pub source_time: f64,
    /// File of the pose; the default is the first example.
    pub file: Option<String>,
    /// The body part with the pose, named as in [`Part::named`]; the default is the body.
    pub part: Option<String>,
    /// Horizontal place of the root joint, in file units. The root trajectory is warped through
    /// this place; the default is a free trajectory.
    pub place: Option<[f64; 2]>,
    /// Seconds before and after that blend into the pose; 0.4 by default.
    pub reach: Option<f64>,
    /// Name in messages: the file and the key frame's number in the file.
    #[serde(skip)]
    pub name: String,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    keyframe: Vec<Keyframe>,
}

impl Keyframe {
    /// The key frames of a TOML file: tables `[[keyframe]]` with `time` and `source_time` in
    /// seconds, optionally `file`, `part`, `place` and `reach`.
    ///
    /// # Errors
    /// Fails for a malformed file.
    pub fn read(text: &str, file: &str) -> Result<Vec<Self>, Error> {
        let hint = "docs/matching.md describes files of key frames";
        let mut parsed: Document = read_toml(text, file, hint)?;
        if parsed.keyframe.is_empty() {
            return Err(Error::file(file, "has no `[[keyframe]]`", hint));
        }
        for (index, keyframe) in parsed.keyframe.iter_mut().enumerate() {
            keyframe.name = format!("{file}, key frame {}", index + 1);
            let name = &keyframe.name;
            let is_near = |place: &[f64; 2]| place.iter().all(|v| v.abs() <= FURTHEST);
            if let Some(place) = keyframe.place.filter(|place| !is_near(place)) {
                let allowed = format!("two numbers of at most {FURTHEST:e}");
                let problem = format!("`place` is {place:?}, allowed: {allowed}");
                return Err(Error::file(name, problem, hint));
            }
            for (field, number) in [
                ("time", Some(keyframe.time)),
                ("source_time", Some(keyframe.source_time)),
                ("reach", keyframe.reach),
            ] {
                if let Some(number) = number.filter(|number| !(0.0..=LATEST).contains(number)) {
                    let problem =
                        format!("`{field}` is {number:?}, allowed: 0 to {LATEST:e} seconds");
                    return Err(Error::file(name, problem, hint));
                }
            }
        }
        Ok(parsed.keyframe)
    }

    pub(crate) fn called(&self) -> &str {
        match self.name.as_str() {
            "" => "key frame",
            name => name,
        }
    }

    /// The constraint of a motion of `frames` frames: the pose of `source`, whose matrix is
    /// `poses`, without the horizontal trajectory. Fails for a time outside of the motion or the
    /// source, and for an unknown part.
    pub fn constraint(
        &self,
        layout: &MotionMatrix,
        parts: &[Part],
        source: &Example,
        poses: &Frames,
        frames: usize,
    ) -> Result<Constraint, Error> {
        let frame = |seconds: f64| (seconds / layout.frame_time()).round() as usize;
        let (t, from) = (frame(self.time), frame(self.source_time));
        let end = |frames: usize| (frames - 1) as f64 * layout.frame_time();
        if from >= poses.frames() {
            let problem = format!(
                "`source_time` is {}, allowed: 0 to {:.2}, where {} ends",
                self.source_time,
                end(poses.frames()),
                source.file
            );
            let hint = "`source_time` is in seconds of the motion that has the pose";
            return Err(Error::file(self.called(), problem, hint));
        }
        if t >= frames {
            let problem = format!("`time` is {}, allowed: 0 to {:.2}", self.time, end(frames));
            let hint = "a longer option `length` has room for it";
            return Err(Error::file(self.called(), problem, hint));
        }
        let part = match &self.part {
            Some(name) => Part::named(name, parts, layout, self.called())?,
            None => Part::body(layout),
        };
        let mut channels = part.channels(layout).channels;
        // The horizontal trajectory consists of displacements, not places.
        channels.retain(|channel| {
            *channel == layout.height() || !layout.root_channels().contains(channel)
        });
        Ok(Constraint::Keyframe {
            at: (t as f64 + 0.5) / frames as f64,
            source: poses.columns(&channels),
            from,
            frames,
            channels,
            reach: frame(self.reach.unwrap_or(REACH)).min(frames),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MatrixOptions;
    use crate::motion_matrix::tests::example;

    #[test]
    fn key_frames_are_read_and_bounded() {
        let walk = example("walk.bvh", 60, 1.0 / 30.0);
        let layout =
            MotionMatrix::new(std::slice::from_ref(&walk), MatrixOptions::default()).unwrap();
        let poses = layout.to_frames(&walk).unwrap();
        let read = |text: &str| Keyframe::read(text, "k.toml");
        let text = "[[keyframe]]\ntime = 2.0\nsource_time = 0.5\npart = 'LeftLeg'\n";
        let [key] = &read(text).unwrap()[..] else {
            panic!("one")
        };
        let constraint = key.constraint(&layout, &[], &walk, &poses, 90).unwrap();
        let Constraint::Keyframe {
            at,
            channels,
            source,
            from,
            reach,
            ..
        } = constraint
        else {
            panic!("a key frame")
        };
        assert!((at - 60.5 / 90.0).abs() < 1e-12);
        assert_eq!((channels.len(), reach), (12, 12));
        assert_eq!(from, 15);
        assert_eq!(source.frame(15)[0], poses.frame(15)[channels[0]]);
        let late = key
            .constraint(&layout, &[], &walk, &poses, 50)
            .unwrap_err()
            .to_string();
        assert_eq!(late, "k.toml, key frame 1: `time` is 2, allowed: 0 to 1.63");
        let body = Keyframe {
            part: None,
            ..key.clone()
        };
        let constraint = body.constraint(&layout, &[], &walk, &poses, 90).unwrap();
        let Constraint::Keyframe { channels, .. } = constraint else {
            panic!("a key frame")
        };
        assert_eq!(channels.len(), layout.channels() - 2);
        for (text, message) in [
            (
                "[[keyframe]]\ntime = -1.0\nsource_time = 0.0",
                "k.toml, key frame 1: `time` is -1.0, allowed: 0 to 1e6 seconds",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\nplace = [nan, 1.0]",
                "k.toml:4: `keyframe[0].place[0]`: NaN is not a finite number",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\nplace = [1e300, 1.0]",
                "`place` is [1e300, 1.0]",
            ),
            ("keyframe = []", "has no `[[keyframe]]`"),
            (
                "[[keyframe]]\ntime = 1.0",
                "k.toml:1: `keyframe[0].source_time`: the key is missing",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\npose = 1",
                "k.toml:4: unknown key `keyframe[0].pose`",
            ),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
