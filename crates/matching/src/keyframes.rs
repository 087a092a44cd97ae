//! Key frames of a new motion, from a TOML file.

use serde::Deserialize;

use crate::{Constraint, Error, Example, Frames, MotionMatrix, Part};

/// Seconds before and after a key frame that bend towards it.
const REACH: f64 = 0.4;

/// Largest coordinate of a place, in the file's units: beyond it, single precision knows no step.
const FURTHEST: f64 = 1e6;

/// The latest moment, in seconds.
const LATEST: f64 = 1e6;

/// A pose that the new motion takes at a moment.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Keyframe {
    /// When, in seconds.
    pub time: f64,
    /// The moment of the source at which it has the pose, in seconds.
    pub source_time: f64,
    /// File that the pose is taken from; without one the first example.
    pub file: Option<String>,
    /// The part of the body that takes the pose, named as in [`Part::named`]; without one all of
    /// it.
    pub part: Option<String>,
    /// Where the joint that travels is then, on the two axes that do not point up, in the file's
    /// units. The way is bent towards it; without it the way goes on as it does.
    pub place: Option<[f64; 2]>,
    /// Seconds before and after it that bend towards the pose; without it 0.4.
    pub reach: Option<f64>,
    /// What messages call it: the file that it is of, and its number there.
    #[serde(skip)]
    pub name: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    keyframe: Vec<Keyframe>,
}

impl Keyframe {
    /// The key frames of a TOML file: tables `[[keyframe]]` with `time` and `source_time` in seconds,
    /// and where they are needed `file`, `part`, `place` and `reach`.
    ///
    /// # Errors
    /// For a file that cannot be read so.
    pub fn read(text: &str, file: &str) -> Result<Vec<Self>, Error> {
        let hint = "docs/matching.md describes files of key frames";
        let mut document: Document =
            toml::from_str(text).map_err(|error| Error::toml(file, text, &error, hint))?;
        if document.keyframe.is_empty() {
            return Err(Error::file(file, "holds no `[[keyframe]]`", hint));
        }
        for (index, keyframe) in document.keyframe.iter_mut().enumerate() {
            keyframe.name = format!("{file}, key frame {}", index + 1);
            let name = &keyframe.name;
            let is_near = |place: &[f64; 2]| place.iter().all(|v| v.abs() <= FURTHEST);
            if let Some(place) = keyframe.place.filter(|place| !is_near(place)) {
                let problem =
                    format!("`place` is {place:?}, allowed: two numbers of at most {FURTHEST:e}");
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
        Ok(document.keyframe)
    }

    /// What messages call it.
    pub(crate) fn called(&self) -> &str {
        match self.name.as_str() {
            "" => "key frame",
            name => name,
        }
    }

    /// What a motion of `frames` frames must keep to: the pose of `source`, whose matrix is
    /// `poses`, but for the horizontal way.
    ///
    /// # Errors
    /// For a moment that the motion or the source does not have, or an unknown part.
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
            None => Part::whole(layout),
        };
        let mut channels = part.channels(layout).channels;
        // The horizontal way says how the body moves on, not where it is.
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
        let whole = Keyframe {
            part: None,
            ..key.clone()
        };
        let constraint = whole.constraint(&layout, &[], &walk, &poses, 90).unwrap();
        let Constraint::Keyframe { channels, .. } = constraint else {
            panic!("a key frame")
        };
        assert_eq!(channels.len(), layout.channels() - 2);
        for (text, said) in [
            (
                "[[keyframe]]\ntime = -1.0\nsource_time = 0.0",
                "k.toml, key frame 1: `time` is -1.0, allowed: 0 to 1e6 seconds",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\nplace = [nan, 1.0]",
                "`place` is [NaN, 1.0], allowed: two numbers of at most 1e6",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\nplace = [1e300, 1.0]",
                "`place` is [1e300, 1.0]",
            ),
            ("keyframe = []", "holds no `[[keyframe]]`"),
            (
                "[[keyframe]]\ntime = 1.0",
                "line 1: missing field `source_time`",
            ),
            (
                "[[keyframe]]\ntime = 1.0\nsource_time = 1.0\npose = 1",
                "unknown field `pose`",
            ),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
