//! Stored audio features: the 163 features of CC-MotionGen, sections 4.1 and 4.3, and optional
//! beats.

use std::ops::Range;

use kinegrad_audio::pulse::BEAT_FEATURES;
use kinegrad_audio::{Features, Pulse};

use crate::audio_layout::{AUDIO_CHANNELS, AudioLayout};
use crate::magnitude::{first_unusable, is_usable};

/// Names and rows of the arrays in `features.npz`, in stacking order.
pub const FEATURES: [(&str, usize); 6] = [
    ("mel", 128),
    ("chroma", 12),
    ("mfcc", 20),
    ("rms", 1),
    ("spectral_centroid", 1),
    ("onset_strength", 1),
];

/// Name and rows of the array of beat features in `features.npz`.
pub const BEATS: (&str, usize) = ("beats", BEAT_FEATURES.len());

/// Name of an audio channel, such as `mel[17]`, `rms` or `beats.bar_sin`.
pub fn audio_channel_name(channel: usize) -> String {
    let mut row = channel;
    for (name, rows) in FEATURES {
        if row < rows {
            return if rows == 1 {
                name.to_owned()
            } else {
                format!("{name}[{row}]")
            };
        }
        row -= rows;
    }
    match BEAT_FEATURES.get(row) {
        Some(name) => format!("{}.{name}", BEATS.0),
        None => panic!("audio channel {channel}"),
    }
}

/// Audio features at 30 frames per second, `[channels, frames]`: 163 channels, or 170 with beats.
#[derive(Clone, Debug, PartialEq)]
pub struct AudioFeatures {
    frames: usize,
    layout: AudioLayout,
    values: Vec<f32>,
}

impl AudioFeatures {
    /// Features from `[163, frames]` or `[170, frames]` values; `None` for other sizes.
    pub fn new(frames: usize, values: Vec<f32>) -> Option<Self> {
        let layouts = [AudioLayout::CCMOTION, AudioLayout::WITH_BEATS];
        let fits = |layout: &AudioLayout| values.len() == layout.channels() * frames;
        let layout = layouts.into_iter().find(fits)?;
        Some(Self {
            frames,
            layout,
            values,
        })
    }

    /// Silence, also the null condition of classifier-free guidance: `[channels, frames]` zeros.
    pub fn silence(layout: AudioLayout, frames: usize) -> Self {
        Self {
            frames,
            layout,
            values: vec![0.0; layout.channels() * frames],
        }
    }

    /// A song's features in `layout`, with beat features from `pulse`; zeros without `pulse`.
    pub fn of_song(features: &Features, layout: AudioLayout, pulse: Option<&Pulse>) -> Self {
        let ccmotion = Self {
            frames: features.frames(),
            layout: AudioLayout::CCMOTION,
            values: features.stacked().to_vec(),
        };
        match layout.beats {
            true => ccmotion.with_beats(pulse),
            false => ccmotion,
        }
    }

    /// The 163 features with the beat features of `pulse`, whose second 0 is frame 0; zeros without
    /// `pulse`.
    pub fn with_beats(&self, pulse: Option<&Pulse>) -> Self {
        let mut values = self.values[..AUDIO_CHANNELS * self.frames].to_vec();
        match pulse {
            Some(pulse) => values.extend(pulse.features(self.frames)),
            None => values.resize(AudioLayout::WITH_BEATS.channels() * self.frames, 0.0),
        }
        Self {
            frames: self.frames,
            layout: AudioLayout::WITH_BEATS,
            values,
        }
    }

    /// The groups of features.
    pub fn layout(&self) -> AudioLayout {
        self.layout
    }

    /// Features of a frame.
    pub fn channels(&self) -> usize {
        self.layout.channels()
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// All values, `[channels, frames]`, channel-major.
    pub fn as_slice(&self) -> &[f32] {
        &self.values
    }

    /// Name, rows and values of each stored array.
    pub(crate) fn arrays(&self) -> impl Iterator<Item = (&'static str, usize, &[f32])> {
        let mut rest = self.as_slice();
        self.layout.arrays().map(move |(name, rows)| {
            let (values, after) = rest.split_at(rows * self.frames);
            rest = after;
            (name, rows, values)
        })
    }

    /// One channel over time, `[frames]`.
    pub fn channel(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.frames..][..self.frames]
    }

    /// Removes the bar positions from beat features.
    pub fn forget_bars(&mut self) {
        for (row, name) in BEAT_FEATURES.iter().enumerate() {
            if self.layout.beats && name.starts_with("bar_") {
                self.channel_mut(AUDIO_CHANNELS + row).fill(0.0);
            }
        }
    }

    /// Onset strength over time, the last of the 163 channels, `[frames]`.
    pub fn onset_strength(&self) -> &[f32] {
        self.channel(AUDIO_CHANNELS - 1)
    }

    /// One channel over time, `[frames]`, mutable.
    pub(crate) fn channel_mut(&mut self, channel: usize) -> &mut [f32] {
        &mut self.values[channel * self.frames..][..self.frames]
    }

    /// The frames of `range`, `[channels, range.len()]`.
    pub fn slice(&self, range: Range<usize>) -> Self {
        self.each_channel(range.len(), |row| row[range.clone()].iter().copied())
    }

    /// The frames at these indices, `[channels, frames.len()]`.
    pub fn at_frames(&self, frames: &[usize]) -> Self {
        self.each_channel(frames.len(), |row| frames.iter().map(|&frame| row[frame]))
    }

    /// `frames` values of each channel.
    fn each_channel<'a, I: Iterator<Item = f32>>(
        &'a self,
        frames: usize,
        values: impl Fn(&'a [f32]) -> I,
    ) -> Self {
        let mut selected = Vec::with_capacity(self.channels() * frames);
        for channel in 0..self.channels() {
            selected.extend(values(self.channel(channel)));
        }
        Self {
            frames,
            layout: self.layout,
            values: selected,
        }
    }

    /// Frame and channel of the first unusable value in time.
    pub(crate) fn first_unusable(&self) -> Option<(usize, usize)> {
        first_unusable(&self.values)?;
        let values = self.values.iter().enumerate();
        let bad = values.filter(|&(_, &value)| !is_usable(value));
        bad.map(|(place, _)| (place % self.frames, place / self.frames))
            .min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_named_in_the_stacking_order() {
        assert_eq!(
            FEATURES.iter().map(|(_, rows)| rows).sum::<usize>(),
            AUDIO_CHANNELS
        );
        for (channel, name) in [
            (0, "mel[0]"),
            (127, "mel[127]"),
            (128, "chroma[0]"),
            (140, "mfcc[0]"),
            (159, "mfcc[19]"),
            (160, "rms"),
            (161, "spectral_centroid"),
            (162, "onset_strength"),
            (163, "beats.beat_sin"),
            (169, "beats.tempo"),
        ] {
            assert_eq!(audio_channel_name(channel), name);
        }
    }

    #[test]
    fn the_onset_strength_is_the_channel_of_that_name() {
        assert_eq!(audio_channel_name(AUDIO_CHANNELS - 1), "onset_strength");
    }

    #[test]
    fn a_slice_keeps_every_channel_in_its_place() {
        let values: Vec<f32> = (0..AUDIO_CHANNELS * 5).map(|i| i as f32).collect();
        let cut = AudioFeatures::new(5, values).unwrap().slice(2..4);
        assert_eq!(cut.frames(), 2);
        assert_eq!(cut.channel(0), [2.0, 3.0]);
        assert_eq!(cut.channel(162), [812.0, 813.0]);
        assert!(AudioFeatures::new(5, vec![0.0; 5]).is_none());
    }

    #[test]
    fn frames_in_another_order_keep_their_channels() {
        let values: Vec<f32> = (0..AUDIO_CHANNELS * 5).map(|i| i as f32).collect();
        let features = AudioFeatures::new(5, values).unwrap();
        let other = features.at_frames(&[4, 0, 4]);
        assert_eq!(other.frames(), 3);
        assert_eq!(other.channel(0), [4.0, 0.0, 4.0]);
        assert_eq!(other.channel(162), [814.0, 810.0, 814.0]);
        assert_eq!(features.at_frames(&[2, 3]), features.slice(2..4));
    }

    #[test]
    fn beats_come_behind_the_163_and_take_nothing_from_them() {
        let values: Vec<f32> = (0..AUDIO_CHANNELS * 9).map(|i| i as f32).collect();
        let ccmotion = AudioFeatures::new(9, values).unwrap();
        let pulse = Pulse::new(vec![0.0, 0.1, 0.2, 0.3]).unwrap();
        let both = ccmotion.with_beats(Some(&pulse));
        assert_eq!((both.channels(), both.frames()), (170, 9));
        assert_eq!(
            both.channel(AUDIO_CHANNELS - 1),
            ccmotion.channel(AUDIO_CHANNELS - 1)
        );
        let cosine = both.channel(164);
        assert!((cosine[3] - 1.0).abs() < 1e-6 && (cosine[1] + 0.5).abs() < 1e-6);
        let cut = both.slice(3..5);
        assert_eq!(cut.channel(164), &cosine[3..5]);
        let again = AudioFeatures::new(9, both.as_slice().to_vec()).unwrap();
        assert_eq!(again, both);
        // A new pulse replaces the old beat features; without a pulse they are zero.
        let none = both.with_beats(None);
        assert_eq!(none.layout(), AudioLayout::WITH_BEATS);
        assert!((163..170).all(|c| none.channel(c).iter().all(|v| *v == 0.0)));
    }

    #[test]
    fn the_first_bad_value_in_time_is_found() {
        let mut features = AudioFeatures::silence(AudioLayout::CCMOTION, 6);
        assert_eq!(features.first_unusable(), None);
        features.channel_mut(3)[4] = f32::NAN;
        features.channel_mut(100)[2] = f32::INFINITY;
        assert_eq!(features.first_unusable(), Some((2, 100)));
    }
}
