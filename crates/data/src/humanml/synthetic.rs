//! Synthetic clips: walks along random paths with captions, determined by seed and index.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::path::Path;

use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_motion::humanml::{Extraction, Joints, Skeleton, TEXT_CHANNELS};
use kinegrad_motion::metrics::text_motion::Token;
use kinegrad_random::{Key, Purpose};
use rayon::prelude::*;

use crate::item_store::{ItemSource, ReadItem, ReadRequest};
use crate::split::Split;
use crate::synthetic::write_whole;
use crate::{DataConfig, DataKind, Error, FileError, SyntheticConfig, ValidationSplit, atomic};

use super::clip::{self, features_path, write_features};
use super::texts::{self, texts_path};
use super::{Caption, Clip, embeddings};

/// Id of synthetic walk number `index`: `walk_00007`.
pub fn synthetic_id(index: usize) -> String {
    format!("walk_{index:05}")
}

/// Walk number `index` of this `seed`: `frames` frames of features of [`Skeleton::humanml3d`] at 20
/// frames per second, with captions. The words of a caption determine its unit-length embedding.
/// Panics if `frames` is zero.
pub fn walk(index: usize, frames: usize, seed: u64) -> Clip {
    walk_of(&Skeleton::humanml3d(), index, frames, seed)
}

/// [`walk`] of a skeleton with the joints of HumanML3D, at its rate.
fn walk_of(skeleton: &Skeleton, index: usize, frames: usize, seed: u64) -> Clip {
    let key = Key::new(seed, Purpose::Synthetic)
        .named("walk")
        .at(index as u64);
    let seconds = frames as f64 / skeleton.description().fps;
    let plan = Plan::new(key, seconds);
    // Every row of features needs the next frame.
    let joints = walk::joints(&plan.course(), skeleton, frames + 1);
    let joints = Joints::new(joints, skeleton.joints()).expect("whole finite frames");
    let extraction = Extraction {
        rescale: false,
        ..Extraction::default()
    };
    let features = extraction.features(skeleton, &joints);
    Clip {
        id: synthetic_id(index),
        features: features.expect("joints of the skeleton"),
        captions: plan.captions(seconds),
    }
}

/// The shape of a walk, and its captions.
struct Plan {
    shape: Shape,
    /// +1 to the left, -1 to the right.
    side: f64,
    /// Index in [`PACES`].
    pace: usize,
    /// Meters per second.
    speed: f64,
    /// Phase of the slow change of speed, radians.
    ease: f64,
    /// Sharpness of circles and windings, 0 to 1.
    sharpness: f64,
    /// Middle of a turn, seconds.
    turn_seconds: f64,
}

#[derive(Clone, Copy)]
enum Shape {
    Straight,
    Circle,
    Turn,
    Winding,
}

const SHAPES: [Shape; 4] = [Shape::Straight, Shape::Circle, Shape::Turn, Shape::Winding];

/// Minimum speed of each pace in meters per second, and the words for the pace.
const PACES: [(f64, &str, &str); 3] = [
    (0.6, "walks slowly", "walking slowly"),
    (0.95, "walks", "walking"),
    (1.3, "walks fast", "walking quickly"),
];

/// Duration of a quarter turn, seconds.
const TURN_SECONDS: f64 = 1.6;

impl Plan {
    fn new(key: Key, seconds: f64) -> Self {
        let uniform = |place: u64| key.at(place).uniform();
        let pace = key.at(0).integers(1, PACES.len())[0];
        Self {
            shape: SHAPES[key.at(1).integers(1, SHAPES.len())[0]],
            side: if uniform(2) < 0.5 { 1.0 } else { -1.0 },
            pace,
            speed: PACES[pace].0 + 0.25 * uniform(3),
            ease: TAU * uniform(4),
            sharpness: uniform(5),
            turn_seconds: (0.45 + 0.1 * uniform(6)) * seconds,
        }
    }

    fn course(&self) -> Course {
        let (side, speed, ease) = (self.side, self.speed, self.ease);
        let (sharpness, turn_seconds) = (self.sharpness, self.turn_seconds);
        let turning: Box<dyn Fn(f64) -> f64> = match self.shape {
            Shape::Straight => Box::new(|_| 0.0),
            Shape::Circle => Box::new(move |_| side * (0.5 + 0.4 * sharpness)),
            Shape::Turn => Box::new(move |time| {
                let place = (time - turn_seconds) / TURN_SECONDS;
                match place.abs() < 0.5 {
                    true => side * PI / 2.0 / TURN_SECONDS * (1.0 + (TAU * place).cos()),
                    false => 0.0,
                }
            }),
            Shape::Winding => {
                Box::new(move |time| side * (0.6 + 0.4 * sharpness) * (TAU * time / 4.0).sin())
            }
        };
        Course {
            speed: Box::new(move |time| speed * (1.0 + 0.04 * (TAU * time / 5.0 + ease).sin())),
            turning,
        }
    }

    /// Two captions of the whole walk. A walk with a turn also has captions for its two halves.
    fn captions(&self, seconds: f64) -> Vec<Caption> {
        let side = if self.side > 0.0 { "left" } else { "right" };
        let (_, walks, walking) = PACES[self.pace];
        let whole = match self.shape {
            Shape::Straight => [
                format!("a person {walks} forward"),
                format!("someone is {walking} in a straight line"),
            ],
            Shape::Circle => [
                format!("a person {walks} in a circle to the {side}"),
                format!("someone is {walking} around in a circle, turning {side}"),
            ],
            Shape::Turn => [
                format!("a person {walks} and turns {side}"),
                format!("someone is {walking} forward and then goes {side}"),
            ],
            Shape::Winding => [
                format!("a person {walks} along a winding path"),
                format!("someone is {walking} and swerves from side to side"),
            ],
        };
        let mut captions = whole.map(|text| caption(text, None)).to_vec();
        if matches!(self.shape, Shape::Turn) {
            let tenths = |seconds: f64| (10.0 * seconds).round() / 10.0;
            let turn = tenths(self.turn_seconds);
            let before = format!("a person {walks} forward");
            let after = format!("a person turns {side} and {walks} on");
            captions.push(caption(before, Some((0.0, turn))));
            captions.push(caption(after, Some((turn, tenths(seconds)))));
        }
        captions
    }
}

fn caption(text: String, seconds: Option<(f64, f64)>) -> Caption {
    let noise = Key::new(0, Purpose::Synthetic)
        .named(&text)
        .normals(TEXT_CHANNELS);
    let square: f64 = noise.iter().map(|&value| f64::from(value).powi(2)).sum();
    let unit = noise.iter().map(|value| value / square.sqrt() as f32);
    Caption {
        embedding: Some(unit.collect()),
        tokens: Token::parse_all(&text),
        text,
        seconds,
    }
}

/// Walks that are synthesized on demand.
#[derive(Debug)]
pub(super) struct Walks {
    config: SyntheticConfig,
    conditional: bool,
    min_frames: usize,
    /// Frames per second; the skeleton's if absent.
    fps: Option<f64>,
}

impl Walks {
    /// The walks of a valid `config`, with embeddings if `conditional`.
    pub fn new(config: &DataConfig, conditional: bool) -> Self {
        Self {
            config: config.synthetic.clone(),
            conditional,
            min_frames: config.humanml3d.min_frames,
            fps: config.humanml3d.fps,
        }
    }
}

impl ItemSource<Clip> for Walks {
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<Clip>, FileError> {
        let skeleton = Skeleton::humanml3d();
        let skeleton = match self.fps {
            Some(fps) => skeleton.at_rate(fps),
            None => skeleton,
        };
        let SyntheticConfig { frames, seed, .. } = self.config;
        let mut clip = walk_of(&skeleton, request.number, frames, seed);
        clip.drop_short_captions(skeleton.description().fps, self.min_frames);
        if !self.conditional {
            clip.captions
                .iter_mut()
                .for_each(|caption| caption.embedding = None);
        }
        Ok(ReadItem::of(clip))
    }

    fn fingerprint(&self) -> String {
        let Self {
            config,
            conditional,
            min_frames,
            fps,
        } = self;
        let rate = fps.map(|fps| format!(" at {fps} fps")).unwrap_or_default();
        format!(
            "Walks {{ config: {config:?}, conditional: {conditional:?}, min_frames: {min_frames:?} }}{rate}"
        )
    }
}

/// Writes `clips` walks of this `seed`, `frames` frames each, into `folder` in the layout of
/// HumanML3D with embeddings. A tenth is held out, as with `kind = "synthetic_walks"`. Fails with
/// [`Error::Config`] for sizes out of range, [`Error::Exists`] if `folder` contains a dataset,
/// [`Error::Io`].
pub fn write_walks(folder: &Path, clips: usize, frames: usize, seed: u64) -> Result<(), Error> {
    let config = DataConfig {
        kind: DataKind::SyntheticWalks,
        synthetic: SyntheticConfig {
            phrases: clips,
            frames,
            seed,
        },
        ..DataConfig::default()
    };
    config.validate()?;
    let names = config.humanml3d;
    let parts = [
        clip::FEATURES,
        texts::TEXTS,
        &names.train_list,
        &names.validation_list,
        &names.text_embeddings,
    ];
    write_whole(folder, &parts, |staging| {
        let captions: Vec<(String, Vec<Caption>)> = (0..clips)
            .into_par_iter()
            .map(|index| {
                let clip = walk(index, frames, seed);
                write_features(&staging.join(features_path(&clip.id)), &clip.features)?;
                let lines: String = clip.captions.iter().map(Caption::line).collect();
                atomic::write(&staging.join(texts_path(&clip.id)), lines.as_bytes())?;
                Ok((clip.id, clip.captions))
            })
            .collect::<Result<_, Error>>()?;
        let split = Split::new(&ValidationSplit::default())?;
        let ids = captions.iter().map(|(id, _)| (id.as_str(), None));
        let ids: Vec<_> = ids.collect();
        let held_out = split.holds_out(&ids);
        for (list, side) in [(&names.train_list, false), (&names.validation_list, true)] {
            let of_side = ids
                .iter()
                .zip(&held_out)
                .filter(|(_, held_out)| **held_out == side);
            let text: String = of_side.map(|((id, _), _)| format!("{id}\n")).collect();
            atomic::write(&staging.join(list), text.as_bytes())?;
        }
        let rows = captions.iter().map(|(id, captions)| {
            let rows = captions.iter();
            let rows = rows.filter_map(|caption| caption.embedding.as_deref());
            (id.as_str(), rows.collect())
        });
        let bytes = embeddings::serialize(rows, HashMap::new());
        atomic::write(&staging.join(&names.text_embeddings), &bytes)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn walks_differ_by_number_and_by_seed_and_by_nothing_else() {
        let one = walk(0, 60, 0);
        assert_eq!(one, walk(0, 60, 0));
        assert_eq!((one.id.as_str(), one.features.frames()), ("walk_00000", 60));
        for other in [walk(1, 60, 0), walk(0, 60, 1)] {
            assert_ne!(one.features, other.features);
        }
    }

    #[test]
    fn captions_say_where_and_how_fast_the_walk_goes() {
        let mut texts = BTreeSet::new();
        for index in 0..60 {
            let clip = walk(index, 120, 2);
            let absolute = clip.features.to_absolute();
            let positions = absolute.root_positions();
            let steps = positions
                .windows(2)
                .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][2] - pair[0][2]));
            let speed = steps.sum::<f64>() * 20.0 / 119.0;
            let text = &clip.captions[0].text;
            let pace = match text {
                _ if text.contains("slowly") => 0.57..0.9,
                _ if text.contains("fast") => 1.2..1.65,
                _ => 0.9..1.26,
            };
            assert!(pace.contains(&speed), "{text}: {speed}");
            // The stored angle is minus half the yaw; a turn to the left is positive.
            let yaw = -2.0 * f64::from(absolute.frame(119)[0]);
            let last = positions[119];
            match text {
                _ if text.contains("forward") => {
                    assert!(last[2] > 3.0 && last[0].abs() < 0.6, "{text}: {last:?}");
                }
                _ if text.contains("turns left") => assert!(last[0] > 0.8, "{text}: {last:?}"),
                _ if text.contains("turns right") => assert!(last[0] < -0.8, "{text}: {last:?}"),
                _ if text.contains("to the left") => assert!(yaw > 2.0, "{text}: {yaw}"),
                _ if text.contains("to the right") => assert!(yaw < -2.0, "{text}: {yaw}"),
                _ => assert!(text.contains("winding"), "{text}"),
            }
            for caption in &clip.captions {
                let frames = caption.frames(120, 20.0);
                assert!(frames.len() >= 40, "{caption:?}");
                let embedding = caption.embedding.as_deref().unwrap();
                let square: f32 = embedding.iter().map(|value| value * value).sum();
                assert!((square - 1.0).abs() < 1e-5 && embedding.len() == TEXT_CHANNELS);
                texts.insert(caption.text.clone());
            }
        }
        assert!(texts.len() > 25, "{texts:?}");
        let embedding = |text: &str| caption(text.to_owned(), None).embedding;
        assert_eq!(embedding("a"), embedding("a"));
        assert_ne!(embedding("a"), embedding("b"));
    }
}
