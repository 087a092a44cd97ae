//! Phrases in the context of their recordings.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::derivatives::rederive;
use kinegrad_motion::phrase::{POSITION, VELOCITY};
use kinegrad_motion::{FPS, Phrase, anchor_floor};

use crate::features::AudioFeatures;
use crate::{Error, PhraseItem, PhraseSet};

/// A phrase and the recording around it.
#[derive(Clone, Debug)]
pub struct ContextWindow {
    /// The phrase and the surrounding frames that a crop can reach.
    pub(crate) take: Arc<PhraseItem>,
    /// The phrase's own frames in the recording.
    pub(crate) own: Range<usize>,
    /// The phrase's id.
    pub(crate) id: String,
}

/// Some frames of motion or audio, copied only if changed.
#[derive(Clone, Debug)]
pub(crate) struct Window<'a, T: Clone> {
    /// The data.
    pub of: Cow<'a, T>,
    /// The frames.
    pub frames: Range<usize>,
}

impl<T: Clone> Window<'_, T> {
    /// All frames of changed data.
    pub fn owned(changed: T, frames: impl Fn(&T) -> usize) -> Self {
        Self {
            frames: 0..frames(&changed),
            of: Cow::Owned(changed),
        }
    }
}

impl ContextWindow {
    /// A phrase without neighbors.
    pub(crate) fn alone(phrase: Arc<PhraseItem>) -> Self {
        Self {
            own: 0..phrase.frames(),
            id: phrase.id.clone(),
            take: phrase,
        }
    }

    /// Motion and audio of `frames`.
    pub(crate) fn window(
        &self,
        frames: Range<usize>,
    ) -> (Window<'_, Phrase>, Window<'_, AudioFeatures>) {
        let motion = Window {
            of: Cow::Borrowed(&self.take.motion),
            frames: frames.clone(),
        };
        let audio = Window {
            of: Cow::Borrowed(&self.take.audio),
            frames,
        };
        (motion, audio)
    }

    /// The phrase's own frames, at most `longest`, anchored at the origin.
    pub(crate) fn leading(
        &self,
        longest: usize,
    ) -> (Window<'_, Phrase>, Window<'_, AudioFeatures>) {
        let frames = self.own.start..self.own.start + self.own.len().min(longest);
        let (mut motion, audio) = self.window(frames.clone());
        if frames.start > 0 {
            let mut anchored = self.take.motion.slice(frames);
            anchor_floor(&mut anchored);
            motion = Window::owned(anchored, Phrase::frames);
        }
        (motion, audio)
    }

    /// The possible first frames of a crop of `target_frames`, never empty. A crop of joined
    /// phrases may start up to half a phrase before or after the phrase.
    pub(crate) fn starts(&self, target_frames: usize) -> Range<usize> {
        let frames = self.take.frames();
        let length = frames.min(target_frames);
        let reach = match self.own.len() {
            own if own == frames => 0,
            own => reach(own),
        };
        let last_own = self.own.end.max(self.own.start + length) - length;
        let last = (last_own + reach).min(frames - length);
        let first = self.own.start.saturating_sub(reach).min(last);
        first..last + 1
    }
}

/// Largest distance between a crop's start and its phrase, frames.
fn reach(frames: usize) -> usize {
    frames / 2
}

/// The context of each phrase of a set, created on demand.
#[derive(Clone, Debug)]
pub(crate) struct ContextWindows {
    phrases: PhraseSet,
    /// Positions of the phrases in each phrase's recording; without joining, its own only.
    recordings: Arc<[Range<usize>]>,
    target_frames: usize,
}

impl ContextWindows {
    /// The contexts of `phrases`, sorted by id, alone or `joined` with their neighbors.
    pub fn new(phrases: PhraseSet, target_frames: usize, joined: bool) -> Self {
        let mut recordings = Vec::with_capacity(phrases.len());
        let mut first = 0;
        for position in 0..phrases.len() {
            let next = position + 1;
            if next == phrases.len() || !joined || !follows(&phrases, position) {
                recordings.extend(std::iter::repeat_n(first..next, next - first));
                first = next;
            }
        }
        Self {
            recordings: recordings.into(),
            phrases,
            target_frames,
        }
    }

    /// The phrases.
    pub fn phrases(&self) -> &PhraseSet {
        &self.phrases
    }

    /// True if context `position` is a single phrase in memory.
    pub fn is_cached(&self, position: usize) -> bool {
        self.recordings[position].len() == 1 && self.phrases.is_cached(position)
    }

    /// Reads context `position`.
    pub fn get(&self, position: usize) -> Result<ContextWindow, Error> {
        let recording = &self.recordings[position];
        if recording.len() == 1 {
            return self.phrases.get(position).map(ContextWindow::alone);
        }
        let own = self.phrases.frames(position);
        let needed = reach(own) + self.target_frames.saturating_sub(own);
        let (mut before, mut after) = (0, 0);
        let (mut first, mut end) = (position, position + 1);
        while end < recording.end && after < needed {
            after += self.phrases.frames(end);
            end += 1;
        }
        while first > recording.start && before < needed {
            first -= 1;
            before += self.phrases.frames(first);
        }
        let parts: Vec<_> = (first..end)
            .map(|part| self.phrases.get(part))
            .collect::<Result<_, _>>()?;
        Ok(ContextWindow {
            take: Arc::new(PhraseItem {
                label: parts[position - first].label.clone(),
                ..join(&parts)
            }),
            own: before..before + own,
            id: self.phrases.id(position).to_owned(),
        })
    }
}

/// True if the ids `NAME_FIRSTFRAME` show that the next phrase continues the phrase at `position`.
fn follows(phrases: &PhraseSet, position: usize) -> bool {
    let parse = |id: &str| {
        let (name, first) = id.rsplit_once('_')?;
        Some((name.to_owned(), first.parse::<usize>().ok()?))
    };
    match (parse(phrases.id(position)), parse(phrases.id(position + 1))) {
        (Some((name, first)), Some((next_name, next_first))) => {
            name == next_name && first.checked_add(phrases.frames(position)) == Some(next_first)
        }
        _ => false,
    }
}

/// Joins consecutive phrases. Each phrase is anchored at its first frame and is moved horizontally,
/// so that a seam has the mean velocity of both sides. Quaternion signs are continuous.
fn join(phrases: &[Arc<PhraseItem>]) -> PhraseItem {
    let (first, rest) = phrases.split_first().expect("a run has a phrase");
    if rest.is_empty() {
        return (**first).clone();
    }
    let mut values = first.motion.as_slice().to_vec();
    for phrase in rest {
        let before = Phrase::new(values.clone()).expect("whole frames");
        let mut next = phrase.motion.clone();
        let last = before.frames() - 1;
        let v = before.vector(last.saturating_sub(1), VELOCITY);
        let w = next.vector(0, VELOCITY);
        let seam_velocity = [0, 1, 2].map(|i| (v[i] + w[i]) / 2.0);
        let (from, to) = (before.vector(last, POSITION), next.vector(0, POSITION));
        let shift = [0, 2].map(|i| from[i] + seam_velocity[i] / FPS - to[i]);
        let flip = before.quaternion(last).dot(next.quaternion(0)) < 0.0;
        for t in 0..next.frames() {
            let [x, y, z] = next.vector(t, POSITION);
            next.set_vector(t, POSITION, [x + shift[0], y, z + shift[1]]);
            if flip {
                next.set_quaternion(t, next.quaternion(t).scale(-1.0));
            }
        }
        values.extend_from_slice(next.as_slice());
    }
    let mut motion = Phrase::new(values).expect("whole frames");
    rederive(&mut motion);
    let audio = (0..first.audio.channels())
        .flat_map(|channel| phrases.iter().flat_map(move |p| p.audio.channel(channel)))
        .copied()
        .collect();
    let audio = AudioFeatures::new(motion.frames(), audio).expect("as many frames as the motion");
    PhraseItem {
        id: first.id.clone(),
        motion,
        audio,
        label: first.label.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use kinegrad_motion::{Profile, check, phrase_statistics};

    /// A recording of 90 frames and its phrases of 30 frames, each anchored at the origin.
    fn cut() -> (PhraseItem, Vec<Arc<PhraseItem>>) {
        let whole = synthetic::phrase(0, 90, 4);
        let phrases = (0..3)
            .map(|i| {
                let frames = 30 * i..30 * (i + 1);
                let mut motion = whole.motion.slice(frames.clone());
                anchor_floor(&mut motion);
                if i == 1 {
                    for t in 0..30 {
                        motion.set_quaternion(t, motion.quaternion(t).scale(-1.0));
                    }
                }
                let audio = whole.audio.slice(frames);
                Arc::new(PhraseItem {
                    id: format!("song_{:05}", 100 + 30 * i),
                    motion,
                    audio,
                    label: None,
                })
            })
            .collect();
        (whole, phrases)
    }

    #[test]
    fn joined_phrases_are_the_recording_again() {
        let (whole, phrases) = cut();
        let contexts = ContextWindows::new(phrases.into(), 30, true);
        assert_eq!(contexts.phrases().len(), 3);
        let context = contexts.get(1).unwrap();
        let take = &context.take;
        assert_eq!((take.frames(), context.own.clone()), (90, 30..60));
        assert_eq!(take.audio, whole.audio);
        let mut expected = whole.motion.clone();
        anchor_floor(&mut expected);
        let worst = take
            .motion
            .as_slice()
            .iter()
            .zip(expected.as_slice())
            .enumerate()
            // The velocity at a seam is estimated, so the position may drift a little.
            .filter(|(index, _)| POSITION.contains(&(index % 25)))
            .fold(0.0f32, |worst, (_, (a, b))| worst.max((a - b).abs()));
        assert!(worst < 0.02, "{worst} m off after two seams");
        for t in 1..90 {
            assert!(take.motion.quaternion(t - 1).dot(take.motion.quaternion(t)) > 0.9);
        }
        let statistics = phrase_statistics([&whole.motion]).expect("statistics");
        let report = check(&take.motion, Profile::Strict, Some(&statistics));
        assert!(report.passed, "{report:?}");
    }

    #[test]
    fn only_neighbours_are_joined() {
        let (_, phrases) = cut();
        let apart = vec![phrases[0].clone(), phrases[2].clone()];
        let apart = ContextWindows::new(apart.into(), 20, true);
        assert!((0..2).all(|position| apart.get(position).unwrap().own == (0..30)));
        assert_eq!(apart.get(0).unwrap().starts(20), 0..11);
    }

    #[test]
    fn crops_begin_up_to_half_a_phrase_around() {
        let (_, phrases) = cut();
        let starts = |target_frames: usize| {
            let contexts = ContextWindows::new(phrases.clone().into(), target_frames, true);
            [0, 1, 2].map(|position| {
                let context = contexts.get(position).unwrap();
                let starts = context.starts(target_frames);
                let first = 30 * position - context.own.start;
                first + starts.start..first + starts.end
            })
        };
        assert_eq!(starts(30), [0..16, 15..46, 45..61]);
        assert_eq!(starts(120), [0..1, 0..1, 0..1]);
    }
}
