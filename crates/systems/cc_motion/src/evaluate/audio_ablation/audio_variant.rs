//! Audio that replaces a phrase's own music.

use kinegrad_data::{AudioFeatures, BeatPhrase};
use kinegrad_random::{Key, Purpose};
use serde::{Deserialize, Serialize};

/// A kind of audio condition for samples of a phrase.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AudioVariant {
    /// The phrase's own music.
    Own,
    /// Zeros in every feature: the null condition of guidance.
    Silence,
    /// The phrase's own music with frames in random order.
    Shuffled,
    /// The phrase's own music with reversed frames.
    Reversed,
    /// The phrase's own music, half a beat ahead.
    HalfBeat,
    /// A phrase of another song.
    OtherSong,
}

impl AudioVariant {
    /// All variants, the own music first.
    pub const ALL: [Self; 6] = [
        Self::Own,
        Self::Silence,
        Self::Shuffled,
        Self::Reversed,
        Self::HalfBeat,
        Self::OtherSong,
    ];

    /// Name in files and heading in tables.
    pub fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Own => ("own", "OWN MUSIC"),
            Self::Silence => ("silence", "SILENCE"),
            Self::Shuffled => ("shuffled", "FRAMES SHUFFLED"),
            Self::Reversed => ("reversed", "FRAMES REVERSED"),
            Self::HalfBeat => ("half_beat", "SHIFTED BY HALF A BEAT"),
            Self::OtherSong => ("other_song", "ANOTHER SONG'S"),
        }
    }
}

/// Music that conditions a sample.
#[derive(Clone, Debug)]
pub(super) struct Music {
    /// The features; as many frames as in the phrase.
    pub audio: AudioFeatures,
    /// Bar phases and beats in a bar, if the music has beats.
    pub bars: Option<(Vec<f64>, f64)>,
}

/// The music of the phrase's `variant`; the music of another song comes from one of the
/// `donors`, if any.
pub(super) fn music(
    phrase: &BeatPhrase,
    variant: AudioVariant,
    seed: u64,
    donors: &[BeatPhrase],
) -> Option<Music> {
    let audio = &phrase.phrase.audio;
    let frames = audio.frames();
    let key = Key::new(seed, Purpose::Listening).named(&phrase.phrase.id);
    let with_beats = |of: &BeatPhrase, order: Vec<usize>| Music {
        audio: of.phrase.audio.at_frames(&order),
        bars: Some((
            order.iter().map(|&frame| of.bars[frame]).collect(),
            of.beats_per_bar,
        )),
    };
    let without_beats = |audio| Music { audio, bars: None };
    let reordered = |order: Vec<usize>| without_beats(audio.at_frames(&order));
    Some(match variant {
        AudioVariant::Own => with_beats(phrase, (0..frames).collect()),
        AudioVariant::Silence => without_beats(AudioFeatures::silence(audio.layout(), frames)),
        AudioVariant::Shuffled => reordered(key.at(0).permutation(frames)),
        AudioVariant::Reversed => reordered((0..frames).rev().collect()),
        AudioVariant::HalfBeat => with_beats(
            phrase,
            half_a_beat_later(&phrase.beats(), phrase.beats_per_bar),
        ),
        AudioVariant::OtherSong => {
            let other = donor(phrase, donors, key.at(1))?;
            let length = other.phrase.frames();
            with_beats(other, (0..frames).map(|t| t % length).collect())
        }
    })
}

/// One of the `donors` with another song, preferably at least as long as the phrase.
fn donor<'a>(phrase: &BeatPhrase, donors: &'a [BeatPhrase], key: Key) -> Option<&'a BeatPhrase> {
    let others: Vec<_> = donors
        .iter()
        .filter(|other| other.song != phrase.song)
        .collect();
    let long = |other: &&BeatPhrase| other.phrase.frames() >= phrase.phrase.frames();
    let long: Vec<_> = others.iter().copied().filter(long).collect();
    let among = if long.is_empty() { others } else { long };
    (!among.is_empty()).then(|| among[key.integers(1, among.len())[0]])
}

/// The source frame of each frame, for music half a beat ahead: the frame nearest to half a beat
/// later. Past the end of the phrase, the source is one bar earlier; in a shorter phrase, as few
/// beats earlier as possible.
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

/// The phrases with other music: `held_out` phrases, or training phrases if the held-out phrases
/// have a single song.
pub(super) fn donors<'a>(
    held_out: &'a [BeatPhrase],
    training: &'a [BeatPhrase],
) -> &'a [BeatPhrase] {
    match held_out.windows(2).any(|pair| pair[0].song != pair[1].song) {
        true => held_out,
        false => training,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use kinegrad_data::{AudioLayout, Songs, synthetic};
    use kinegrad_motion::FPS;
    use kinegrad_motion::metrics::phase_error;
    use kinegrad_motion::phrase::PHASE;

    use super::*;

    /// A phrase of a song with `rate` bars per second.
    fn phrase_of(song: &str, index: usize, frames: usize, rate: f64, beats: u32) -> BeatPhrase {
        let mut phrase = synthetic::phrase(index, frames, 1);
        phrase.id = format!("{song}_{index:05}");
        for t in 0..frames {
            let phase = (0.87 + rate * t as f64 / FPS).rem_euclid(1.0);
            phrase.motion.frame_mut(t)[PHASE] = phase as f32;
        }
        BeatPhrase::new(Arc::new(phrase), &Songs::default(), Some(f64::from(beats))).expect("beats")
    }

    /// The frames of `audio`, sorted.
    fn sorted(audio: &AudioFeatures) -> Vec<Vec<u32>> {
        let bits = |t: usize| (0..163).map(|c| audio.channel(c)[t].to_bits()).collect();
        let mut frames: Vec<Vec<u32>> = (0..audio.frames()).map(bits).collect();
        frames.sort_unstable();
        frames
    }

    #[test]
    fn music_half_a_beat_ahead_is_off_the_beat_in_every_frame() {
        for (frames, beats_per_bar, rate) in
            [(120, 4, 0.5), (97, 3, 0.61), (45, 4, 0.43), (24, 4, 0.45)]
        {
            let own = phrase_of("a", 0, frames, rate, beats_per_bar);
            let later = half_a_beat_later(&own.beats(), own.beats_per_bar);
            let beats = f64::from(beats_per_bar);
            let beats_a_frame = rate * beats / FPS;
            for (t, &source) in later.iter().enumerate() {
                let found = phase_error(&[own.bars[source]], &[own.bars[t]], beats);
                let least = 0.5 - 1.01 * beats_a_frame;
                assert!(found > least, "frame {t} of {frames}: {found} {least}");
            }
            let music = music(&own, AudioVariant::HalfBeat, 0, &[]).unwrap();
            let (bars, of_a_bar) = music.bars.unwrap();
            assert_eq!(of_a_bar, beats);
            let found = phase_error(&bars, &own.bars, beats);
            assert!(found > 0.45, "{found}");
            // Most frames have a later source frame, also within the bar.
            let half = (0.5 / beats_a_frame).round() as usize;
            let ahead = later
                .iter()
                .enumerate()
                .filter(|(t, source)| source.abs_diff(t + half) <= 1);
            assert!(ahead.count() + half + 1 >= frames, "{later:?}");
            let onset = own.phrase.audio.onset_strength();
            assert_eq!(music.audio.onset_strength()[3], onset[later[3]]);
        }
    }

    #[test]
    fn frames_in_another_order_are_the_same_frames() {
        let own = phrase_of("a", 0, 50, 0.5, 4);
        let audio = &own.phrase.audio;
        for variant in [AudioVariant::Shuffled, AudioVariant::Reversed] {
            let music = music(&own, variant, 5, &[]).unwrap();
            assert!(music.bars.is_none());
            assert_ne!(&music.audio, audio);
            assert_eq!(sorted(&music.audio), sorted(audio));
        }
        let shuffled = |seed| {
            music(&own, AudioVariant::Shuffled, seed, &[])
                .unwrap()
                .audio
        };
        assert_eq!(shuffled(5), shuffled(5));
        assert_ne!(shuffled(5), shuffled(6));
        let reversed = music(&own, AudioVariant::Reversed, 5, &[]).unwrap().audio;
        assert_eq!(reversed.channel(7)[0], audio.channel(7)[49]);
        let silence = music(&own, AudioVariant::Silence, 5, &[]).unwrap().audio;
        assert_eq!(silence, AudioFeatures::silence(AudioLayout::CCMOTION, 50));
        assert_eq!(
            &music(&own, AudioVariant::Own, 5, &[]).unwrap().audio,
            audio
        );
    }

    #[test]
    fn another_song_is_never_a_phrase_of_the_same() {
        let own = [phrase_of("a", 0, 50, 0.5, 4), phrase_of("a", 1, 50, 0.5, 4)];
        assert!(music(&own[0], AudioVariant::OtherSong, 0, &own).is_none());
        let short = phrase_of("b", 2, 40, 0.6, 3);
        let with_short = [own.to_vec(), vec![short.clone()]].concat();
        let other = |seed, donors: &[BeatPhrase]| {
            music(&own[0], AudioVariant::OtherSong, seed, donors).unwrap()
        };
        let music = other(0, &with_short);
        // The short donor repeats.
        assert_eq!(music.audio.frames(), 50);
        assert_eq!(music.audio.slice(0..40), short.phrase.audio);
        assert_eq!(music.audio.slice(40..50), short.phrase.audio.slice(0..10));
        let (bars, beats_per_bar) = music.bars.unwrap();
        assert_eq!((bars.len(), beats_per_bar), (50, 3.0));
        // A donor that is long enough takes precedence for every seed.
        let long = phrase_of("c", 3, 60, 0.4, 4);
        let all = [with_short.clone(), vec![long.clone()]].concat();
        for seed in 0..8 {
            assert_eq!(other(seed, &all).audio, long.phrase.audio.slice(0..50));
        }
        let training = [long];
        let ids = |chosen: &[BeatPhrase]| chosen[0].phrase.id.clone();
        assert_eq!(ids(donors(&own, &training)), "c_00003");
        assert_eq!(ids(donors(&with_short, &training)), "a_00000");
        assert_eq!(ids(donors(&own[..1], &training)), "c_00003");
    }
}
