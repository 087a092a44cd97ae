//! Passages: a phrase within the recording it was cut from.

use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::kinematics::rederive;
use kinegrad_motion::phrase::{POSITION, VELOCITY};
use kinegrad_motion::{FPS, Motion};

use crate::Phrase;
use crate::features::{AUDIO_CHANNELS, AudioFeatures};

/// A phrase and what was recorded around it.
#[derive(Clone, Debug)]
pub(crate) struct Passage {
    /// The phrase, joined with the neighbours of its recording that are training phrases too.
    pub take: Arc<Phrase>,
    /// The phrase's own frames in the take.
    pub own: Range<usize>,
    /// The phrase's id.
    pub id: String,
}

impl Passage {
    /// A phrase without neighbours.
    pub fn alone(phrase: Arc<Phrase>) -> Self {
        Self {
            own: 0..phrase.frames(),
            id: phrase.id.clone(),
            take: phrase,
        }
    }

    /// The first frames that a crop of `target_frames` may have: those within the phrase, and,
    /// where it has neighbours, up to half its length around. Never empty.
    pub fn starts(&self, target_frames: usize) -> Range<usize> {
        let frames = self.take.frames();
        let length = frames.min(target_frames);
        let reach = if self.own.len() == frames {
            0
        } else {
            self.own.len() / 2
        };
        let last_own = self.own.end.max(self.own.start + length) - length;
        let last = (last_own + reach).min(frames - length);
        let first = self.own.start.saturating_sub(reach).min(last);
        first..last + 1
    }
}

/// A passage for each phrase, in their order; `phrases` are sorted by id.
pub(crate) fn join_neighbours(phrases: &[Arc<Phrase>]) -> Vec<Passage> {
    let mut passages = Vec::with_capacity(phrases.len());
    let mut rest = phrases;
    while !rest.is_empty() {
        let following = rest
            .windows(2)
            .take_while(|pair| follows(&pair[0], &pair[1]))
            .count();
        let (run, after) = rest.split_at(following + 1);
        rest = after;
        let take = Arc::new(join(run));
        let mut start = 0;
        for phrase in run {
            let own = start..start + phrase.frames();
            start = own.end;
            passages.push(Passage {
                take: take.clone(),
                own,
                id: phrase.id.clone(),
            });
        }
    }
    passages
}

/// Whether `next` begins where `phrase` ends: ids `NAME_FIRSTFRAME` of the same recording.
fn follows(phrase: &Phrase, next: &Phrase) -> bool {
    let parse = |id: &str| {
        let (name, first) = id.rsplit_once('_')?;
        Some((name.to_owned(), first.parse::<usize>().ok()?))
    };
    match (parse(&phrase.id), parse(&next.id)) {
        (Some((name, first)), Some((next_name, next_first))) => {
            name == next_name && first + phrase.frames() == next_first
        }
        _ => false,
    }
}

/// One long phrase out of phrases that follow each other.
///
/// Each phrase stands on the floor where its own first frame is the origin, so the next one is
/// moved to go on with the mean of the velocities on both sides of the seam; height is the
/// recording's and stays. Quaternions keep their sign across the seam.
fn join(phrases: &[Arc<Phrase>]) -> Phrase {
    let (first, rest) = phrases.split_first().expect("a run has a phrase");
    if rest.is_empty() {
        return (**first).clone();
    }
    let mut values = first.motion.as_slice().to_vec();
    for phrase in rest {
        let before = Motion::new(values.clone()).expect("whole frames");
        let mut next = phrase.motion.clone();
        let last = before.frames() - 1;
        let seam_velocity = {
            let (v, w) = (
                before.vector(last.saturating_sub(1), VELOCITY),
                next.vector(0, VELOCITY),
            );
            [0, 1, 2].map(|i| (v[i] + w[i]) / 2.0)
        };
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
    let mut motion = Motion::new(values).expect("whole frames");
    rederive(&mut motion);
    let audio = (0..AUDIO_CHANNELS)
        .flat_map(|channel| {
            phrases
                .iter()
                .flat_map(move |phrase| phrase.audio.channel(channel))
        })
        .copied()
        .collect();
    let audio = AudioFeatures::new(motion.frames(), audio).expect("as many frames as the motion");
    Phrase {
        id: first.id.clone(),
        motion,
        audio,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use kinegrad_motion::{Profile, TrainingStatistics, anchor_floor, check};

    /// A recording of 90 frames cut into phrases of 30, each moved to the origin.
    fn cut() -> (Phrase, Vec<Arc<Phrase>>) {
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
                Arc::new(Phrase {
                    id: format!("song_{:05}", 100 + 30 * i),
                    motion,
                    audio,
                })
            })
            .collect();
        (whole, phrases)
    }

    #[test]
    fn joined_phrases_are_the_recording_again() {
        let (whole, phrases) = cut();
        let passages = join_neighbours(&phrases);
        assert_eq!(passages.len(), 3);
        let take = &passages[1].take;
        assert_eq!((take.frames(), passages[1].own.clone()), (90, 30..60));
        assert_eq!(take.audio, whole.audio);
        let mut expected = whole.motion.clone();
        anchor_floor(&mut expected);
        let worst = take
            .motion
            .as_slice()
            .iter()
            .zip(expected.as_slice())
            .enumerate()
            // The seam's velocity is a guess, so position may drift by a little there.
            .filter(|(index, _)| POSITION.contains(&(index % 25)))
            .fold(0.0f32, |worst, (_, (a, b))| worst.max((a - b).abs()));
        assert!(worst < 0.02, "{worst} m off after two seams");
        for t in 1..90 {
            assert!(take.motion.quaternion(t - 1).dot(take.motion.quaternion(t)) > 0.9);
        }
        let statistics = TrainingStatistics::compute([&whole.motion]).expect("statistics");
        let report = check(&take.motion, Profile::Strict, Some(&statistics)).expect("a report");
        assert!(report.passed, "{report:?}");
    }

    #[test]
    fn only_neighbours_are_joined() {
        let (_, phrases) = cut();
        let apart = join_neighbours(&[phrases[0].clone(), phrases[2].clone()]);
        assert!(apart.iter().all(|passage| passage.own == (0..30)));
        assert_eq!(apart[0].starts(20), 0..11);
    }

    #[test]
    fn crops_begin_up_to_half_a_phrase_around() {
        let (_, phrases) = cut();
        let passages = join_neighbours(&phrases);
        let starts: Vec<_> = passages.iter().map(|passage| passage.starts(30)).collect();
        assert_eq!(starts, [0..16, 15..46, 45..61]);
        assert_eq!(passages[2].starts(120), 0..1);
    }
}
