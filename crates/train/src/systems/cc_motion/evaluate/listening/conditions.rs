//! What a model hears in the place of a phrase's music.

use kinegrad_data::AudioFeatures;
use kinegrad_random::{Key, Purpose};
use serde::Serialize;

use super::phrases::Listened;

/// What a model hears.
#[derive(Clone, Copy, Debug, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Heard {
    /// The phrase's own music.
    Own,
    /// Zeros in every feature: the null condition of guidance.
    Silence,
    /// Its frames in random order.
    Shuffled,
    /// Its frames from the last to the first.
    Reversed,
    /// Its music half a beat ahead.
    HalfBeat,
    /// A phrase of another song.
    OtherSong,
}

impl Heard {
    /// All of them, the own music first.
    pub const ALL: [Self; 6] = [
        Self::Own,
        Self::Silence,
        Self::Shuffled,
        Self::Reversed,
        Self::HalfBeat,
        Self::OtherSong,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Own => "own",
            Self::Silence => "silence",
            Self::Shuffled => "shuffled",
            Self::Reversed => "reversed",
            Self::HalfBeat => "half_beat",
            Self::OtherSong => "other_song",
        }
    }

    /// Its heading in tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::Own => "OWN MUSIC",
            Self::Silence => "SILENCE",
            Self::Shuffled => "FRAMES SHUFFLED",
            Self::Reversed => "FRAMES REVERSED",
            Self::HalfBeat => "SHIFTED BY HALF A BEAT",
            Self::OtherSong => "ANOTHER SONG'S",
        }
    }
}

/// Music as a model hears it.
#[derive(Clone, Debug)]
pub(super) struct Music {
    /// The features, as many frames as the phrase has.
    pub audio: AudioFeatures,
    /// Its bar phase and the beats in a bar, where it has beats.
    pub bars: Option<(Vec<f64>, f64)>,
}

impl Listened {
    /// What is `heard` in the place of this phrase's music, one of the `others` for another song's;
    /// `None` where they are none.
    pub(super) fn music(&self, heard: Heard, seed: u64, others: &[Listened]) -> Option<Music> {
        let audio = &self.phrase.audio;
        let frames = audio.frames();
        let key = Key::new(seed, Purpose::Listening).named(&self.phrase.id);
        let own = (self.bars.clone(), self.beats_per_bar);
        Some(match heard {
            Heard::Own => Music {
                audio: audio.clone(),
                bars: Some(own),
            },
            Heard::Silence => Music {
                audio: AudioFeatures::silence(audio.layout(), frames),
                bars: None,
            },
            Heard::Shuffled => Music {
                audio: audio.at_frames(&key.at(0).permutation(frames)),
                bars: None,
            },
            Heard::Reversed => Music {
                audio: audio.at_frames(&(0..frames).rev().collect::<Vec<_>>()),
                bars: None,
            },
            Heard::HalfBeat => {
                let later = half_a_beat_later(&self.beats(), self.beats_per_bar);
                let bars = later.iter().map(|&frame| self.bars[frame]).collect();
                Music {
                    audio: audio.at_frames(&later),
                    bars: Some((bars, self.beats_per_bar)),
                }
            }
            Heard::OtherSong => {
                let other = self.other(others, key.at(1))?;
                let again: Vec<usize> = (0..frames).map(|t| t % other.phrase.frames()).collect();
                let bars = again.iter().map(|&frame| other.bars[frame]).collect();
                Music {
                    audio: other.phrase.audio.at_frames(&again),
                    bars: Some((bars, other.beats_per_bar)),
                }
            }
        })
    }

    /// One of the `others` that is of another song, and as long if there is one.
    fn other<'a>(&self, others: &'a [Listened], key: Key) -> Option<&'a Listened> {
        let of_others = others.iter().filter(|other| other.song != self.song);
        let of_others: Vec<_> = of_others.collect();
        let long = |other: &&Listened| other.phrase.frames() >= self.phrase.frames();
        let long: Vec<_> = of_others.iter().copied().filter(long).collect();
        let among = if long.is_empty() { of_others } else { long };
        (!among.is_empty()).then(|| among[key.integers(1, among.len())[0]])
    }
}

/// The frame that is heard in each frame, for music half a beat ahead: the one nearest to half a
/// beat later. Where the phrase has ended by then, its music goes on with that of a bar before, or,
/// where the phrase is shorter, of as few beats before as it takes.
fn half_a_beat_later(beats: &[f64], beats_per_bar: f64) -> Vec<usize> {
    let (first, last) = (beats[0], beats[beats.len() - 1]);
    let nearest = |beat: f64| {
        let apart = |frame: &usize| (beats[*frame] - beat).abs();
        let frames = 0..beats.len();
        frames
            .min_by(|a, b| apart(a).total_cmp(&apart(b)))
            .unwrap_or(0)
    };
    let later = beats.iter().map(|beat| {
        let mut beat = beat + 0.5;
        if beat > last && beat - beats_per_bar >= first {
            beat -= beats_per_bar;
        }
        while beat > last && beat - 1.0 >= first {
            beat -= 1.0;
        }
        nearest(beat)
    });
    later.collect()
}

/// The phrases that give another song's music: the `held_out` ones, or, where these are of one song,
/// those to train on.
pub(super) fn exchanged<'a>(held_out: &'a [Listened], training: &'a [Listened]) -> &'a [Listened] {
    match held_out.windows(2).any(|pair| pair[0].song != pair[1].song) {
        true => held_out,
        false => training,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use kinegrad_data::{Songs, synthetic};
    use kinegrad_motion::FPS;
    use kinegrad_motion::metrics::phase_error;
    use kinegrad_motion::phrase::PHASE;

    use super::*;

    /// A phrase of a song of that many bars a second.
    fn listened(song: &str, index: usize, frames: usize, rate: f64, beats: u32) -> Listened {
        let mut phrase = synthetic::phrase(index, frames, 1);
        phrase.id = format!("{song}_{index:05}");
        for t in 0..frames {
            let phase = (0.87 + rate * t as f64 / FPS).rem_euclid(1.0);
            phrase.motion.frame_mut(t)[PHASE] = phase as f32;
        }
        Listened::new(Arc::new(phrase), &Songs::default(), Some(f64::from(beats))).expect("beats")
    }

    /// The frames of `audio` in its own order.
    fn sorted(audio: &AudioFeatures) -> Vec<Vec<u32>> {
        let bits = |t: usize| (0..163).map(|c| audio.channel(c)[t].to_bits()).collect();
        let mut frames: Vec<Vec<u32>> = (0..audio.frames()).map(bits).collect();
        frames.sort_unstable();
        frames
    }

    #[test]
    fn music_half_a_beat_ahead_is_out_of_time_in_every_frame() {
        for (frames, beats_per_bar, rate) in
            [(120, 4, 0.5), (97, 3, 0.61), (45, 4, 0.43), (24, 4, 0.45)]
        {
            let own = listened("a", 0, frames, rate, beats_per_bar);
            let later = half_a_beat_later(&own.beats(), own.beats_per_bar);
            let beats = f64::from(beats_per_bar);
            let beats_a_frame = rate * beats / FPS;
            for (t, &heard) in later.iter().enumerate() {
                let found = phase_error(&[own.bars[heard]], &[own.bars[t]], beats);
                let least = 0.5 - 1.01 * beats_a_frame;
                assert!(found > least, "frame {t} of {frames}: {found} {least}");
            }
            let music = own.music(Heard::HalfBeat, 0, &[]).unwrap();
            let (bars, of_a_bar) = music.bars.unwrap();
            assert_eq!(of_a_bar, beats);
            let found = phase_error(&bars, &own.bars, beats);
            assert!(found > 0.45, "{found}");
            // Most frames are simply later ones, in the bar too.
            let half = (0.5 / beats_a_frame).round() as usize;
            let ahead = later
                .iter()
                .enumerate()
                .filter(|(t, heard)| heard.abs_diff(t + half) <= 1);
            assert!(ahead.count() + half + 1 >= frames, "{later:?}");
            let onset = own.phrase.audio.onset_strength();
            assert_eq!(music.audio.onset_strength()[3], onset[later[3]]);
        }
    }

    #[test]
    fn frames_in_another_order_are_the_same_frames() {
        let own = listened("a", 0, 50, 0.5, 4);
        let audio = &own.phrase.audio;
        for heard in [Heard::Shuffled, Heard::Reversed] {
            let music = own.music(heard, 5, &[]).unwrap();
            assert!(music.bars.is_none());
            assert_ne!(&music.audio, audio);
            assert_eq!(sorted(&music.audio), sorted(audio));
        }
        let shuffled = |seed| own.music(Heard::Shuffled, seed, &[]).unwrap().audio;
        assert_eq!(shuffled(5), shuffled(5));
        assert_ne!(shuffled(5), shuffled(6));
        let reversed = own.music(Heard::Reversed, 5, &[]).unwrap().audio;
        assert_eq!(reversed.channel(7)[0], audio.channel(7)[49]);
        let silence = own.music(Heard::Silence, 5, &[]).unwrap().audio;
        assert_eq!(silence, AudioFeatures::zeros(50));
        assert_eq!(&own.music(Heard::Own, 5, &[]).unwrap().audio, audio);
    }

    #[test]
    fn another_song_is_never_a_phrase_of_the_same() {
        let own = [listened("a", 0, 50, 0.5, 4), listened("a", 1, 50, 0.5, 4)];
        assert!(own[0].music(Heard::OtherSong, 0, &own).is_none());
        let short = listened("b", 2, 40, 0.6, 3);
        let with_short = [own.to_vec(), vec![short.clone()]].concat();
        let music = own[0].music(Heard::OtherSong, 0, &with_short).unwrap();
        // The short one goes on from its beginning.
        assert_eq!(music.audio.frames(), 50);
        assert_eq!(music.audio.slice(0..40), short.phrase.audio);
        assert_eq!(music.audio.slice(40..50), short.phrase.audio.slice(0..10));
        let (bars, beats_per_bar) = music.bars.unwrap();
        assert_eq!((bars.len(), beats_per_bar), (50, 3.0));
        // One that is long enough comes first, whatever the seed.
        let long = listened("c", 3, 60, 0.4, 4);
        let all = [with_short.clone(), vec![long.clone()]].concat();
        for seed in 0..8 {
            let music = own[0].music(Heard::OtherSong, seed, &all).unwrap();
            assert_eq!(music.audio, long.phrase.audio.slice(0..50));
        }
        let training = [long];
        let ids = |chosen: &[Listened]| chosen[0].phrase.id.clone();
        assert_eq!(ids(exchanged(&own, &training)), "c_00003");
        assert_eq!(ids(exchanged(&with_short, &training)), "a_00000");
        assert_eq!(ids(exchanged(&own[..1], &training)), "c_00003");
    }
}
