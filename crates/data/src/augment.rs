//! Training samples of phrases: cropping and augmentation.

use std::ops::Range;

use kinegrad_motion::time_stretch::{at_speed, frames_at_speed};
use kinegrad_motion::{Phrase, anchor_floor, mirror, rotate_yaw};
use kinegrad_random::{Key, Purpose};

use crate::audio_layout::AUDIO_CHANNELS;
use crate::context_window::{ContextWindow, Window};
use crate::features::AudioFeatures;
use crate::{AugmentConfig, Crop, DataConfig, time_stretch};

// One key counter per augmentation, below the sample's key, makes the augmentations independent.
const WINDOW: u64 = 0;
const MIRROR: u64 = 1;
const YAW: u64 = 2;
const AUDIO_NOISE: u64 = 3;
const FLIP: u64 = 4;
const AUDIO_MASKS: u64 = 5;
const AUDIO_REPLACE: u64 = 6;
const BAR_DROP: u64 = 7;
const SPEED: u64 = 8;

/// Extra frames after a time-stretched window, for the derivatives of its last frames.
const BEHIND: usize = 4;

/// Creates training samples. Sample n is a function of the seed and n alone.
#[derive(Clone, Debug)]
pub(crate) struct Augmentation {
    seed: u64,
    target_frames: usize,
    crop: Crop,
    augment: AugmentConfig,
}

impl Augmentation {
    /// The sampler of a run with this `seed`.
    pub fn new(config: &DataConfig, seed: u64) -> Self {
        Self {
            seed,
            target_frames: config.target_frames,
            crop: config.crop,
            augment: config.augment.clone(),
        }
    }

    /// Maximum number of frames that a sample reads from a recording.
    pub fn frames_seen(&self) -> usize {
        match self.augment.speed {
            0.0 => self.target_frames,
            most => played_by(self.target_frames, 1.0 + most) + BEHIND,
        }
    }

    /// Motion and audio of sample `n`, at most `target_frames` frames, in the dataset's units.
    pub fn windows<'a>(
        &self,
        context: &'a ContextWindow,
        n: u64,
    ) -> (Window<'a, Phrase>, Window<'a, AudioFeatures>) {
        let AugmentConfig {
            min_frames,
            audio_noise,
            audio_masks,
            audio_replace_prob,
            bar_drop_prob,
            ..
        } = self.augment;
        let (reflect, turn) = (self.augment.mirror, self.augment.rotate_yaw);
        let flip = self.augment.flip_quaternion;
        let key = Key::new(self.seed, Purpose::Augment).at(n);
        let speed = self.speed(key.at(SPEED));
        let mut window = self.crop(context, speed, n);
        if let Some(min_frames) = min_frames {
            window = sub_window(window, played_by(min_frames, speed), key.at(WINDOW));
        }
        let frames = frames_at_speed(window.len(), speed).min(self.target_frames);
        // An unmodified leading crop is already anchored.
        let anchor = window.start > 0 || reflect || turn || min_frames.is_some() || speed != 1.0;
        let (mut motion, mut audio) = context.window(window.clone());
        if anchor || flip {
            let mut changed = match speed {
                1.0 => context.take.motion.slice(window.clone()),
                speed => {
                    let behind = (window.end + BEHIND).min(context.take.frames());
                    at_speed(&context.take.motion.slice(window.start..behind), speed)
                        .slice(0..frames)
                }
            };
            if reflect && key.at(MIRROR).uniform() < 0.5 {
                mirror(&mut changed);
            }
            if turn {
                rotate_yaw(&mut changed, std::f64::consts::TAU * key.at(YAW).uniform());
            }
            if flip && key.at(FLIP).uniform() < 0.5 {
                negate_quaternions(&mut changed);
            }
            if anchor {
                anchor_floor(&mut changed);
            }
            motion = Window::owned(changed, Phrase::frames);
        }
        if speed != 1.0 {
            let played = time_stretch::at_speed(&context.take.audio.slice(window), speed);
            audio = Window::owned(played.slice(0..frames), AudioFeatures::frames);
        }
        let drops_bar = bar_drop_prob > 0.0 && key.at(BAR_DROP).uniform() < bar_drop_prob;
        if audio_noise > 0.0 || audio_masks > 0 || audio_replace_prob > 0.0 || drops_bar {
            let mut changed = audio.of.slice(audio.frames);
            if drops_bar {
                changed.forget_bars();
            }
            if audio_noise > 0.0 {
                changed = with_noise(changed, audio_noise, key.at(AUDIO_NOISE));
            }
            for mask in 0..audio_masks {
                mask_audio(&mut changed, key.at(AUDIO_MASKS).at(mask as u64));
            }
            let replace = key.at(AUDIO_REPLACE);
            if audio_replace_prob > 0.0 && replace.at(0).uniform() < audio_replace_prob {
                let noise = replace.at(1).normals(changed.as_slice().len());
                changed = AudioFeatures::new(changed.frames(), noise).unwrap_or(changed);
            }
            audio = Window::owned(changed, AudioFeatures::frames);
        }
        (motion, audio)
    }

    /// The speed of a sample, log-uniform.
    fn speed(&self, key: Key) -> f64 {
        match self.augment.speed {
            0.0 => 1.0,
            most => (1.0 + most).powf(2.0 * key.uniform() - 1.0),
        }
    }

    /// The frames of sample `n`: the source of `target_frames` frames at `speed`, or a shorter
    /// recording.
    fn crop(&self, context: &ContextWindow, speed: f64, n: u64) -> Range<usize> {
        let target_frames = played_by(self.target_frames, speed);
        let starts = context.starts(target_frames);
        let length = context.take.frames().min(target_frames);
        let start = match self.crop {
            Crop::Random if starts.len() > 1 => {
                starts.start + below(starts.len(), Key::new(self.seed, Purpose::Crop).at(n))
            }
            Crop::Random | Crop::Leading => context.own.start.min(starts.end - 1),
        };
        start..start + length
    }
}

/// Number of source frames for `frames` frames at `speed`.
fn played_by(frames: usize, speed: f64) -> usize {
    ((frames.saturating_sub(1)) as f64 * speed - 1e-9).ceil() as usize + 1
}

/// Negates all quaternions, which keeps the orientations.
fn negate_quaternions(motion: &mut Phrase) {
    for t in 0..motion.frames() {
        motion.set_quaternion(t, motion.quaternion(t).scale(-1.0));
    }
}

/// Zeroes one time range and one band of adjacent features, but no beat features.
fn mask_audio(audio: &mut AudioFeatures, key: Key) {
    let range = |length: usize, longest: usize, key: Key| {
        let start = below(length, key.at(0));
        start..(start + below(longest + 1, key.at(1))).min(length)
    };
    let time = range(audio.frames(), audio.frames() / 5, key.at(0));
    let band = range(AUDIO_CHANNELS, AUDIO_CHANNELS / 4, key.at(1));
    for channel in 0..AUDIO_CHANNELS {
        audio.channel_mut(channel)[time.clone()].fill(0.0);
    }
    for channel in band {
        audio.channel_mut(channel).fill(0.0);
    }
}

/// A random window of at least `min_frames` frames within `window`.
fn sub_window(window: Range<usize>, min_frames: usize, key: Key) -> Range<usize> {
    if window.len() <= min_frames {
        return window;
    }
    let length = min_frames + below(window.len() - min_frames + 1, key.at(0));
    let start = window.start + below(window.len() - length + 1, key.at(1));
    start..start + length
}

fn below(bound: usize, key: Key) -> usize {
    key.integers(1, bound)[0]
}

fn with_noise(audio: AudioFeatures, std: f64, key: Key) -> AudioFeatures {
    let noise = key.normals(audio.as_slice().len());
    let values = audio.as_slice().iter().zip(noise);
    let noisy = values.map(|(value, noise)| value + std as f32 * noise);
    AudioFeatures::new(audio.frames(), noisy.collect()).unwrap_or(audio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use crate::{AudioLayout, PhraseItem};
    use kinegrad_motion::derivatives::{mean_norm, velocity_errors};
    use kinegrad_motion::phrase::POSITION;
    use std::collections::BTreeSet;
    use std::sync::Arc;

    impl Augmentation {
        /// The windows by themselves.
        fn sample(&self, context: &ContextWindow, n: u64) -> (Phrase, AudioFeatures) {
            let (motion, audio) = self.windows(context, n);
            (motion.of.slice(motion.frames), audio.of.slice(audio.frames))
        }
    }

    #[test]
    fn bars_are_forgotten_in_so_many_samples_and_nothing_else_is() {
        let with = synthetic::phrase_in(AudioLayout::WITH_BEATS, 4, 30, 2);
        let [plain, dropping] = [0.0, 0.4].map(|p| sampler(|c| c.augment.bar_drop_prob = p));
        let mut forgotten = 0;
        for n in 0..500 {
            let ((motion, before), (same, after)) = (
                plain.sample(&alone(&with), n),
                dropping.sample(&alone(&with), n),
            );
            assert_eq!(motion, same);
            let hidden = after
                .channel(AUDIO_CHANNELS + 4)
                .iter()
                .all(|known| *known == 0.0);
            for channel in 0..before.channels() {
                let is_bar = (AUDIO_CHANNELS + 2..AUDIO_CHANNELS + 5).contains(&channel);
                match hidden && is_bar {
                    true => assert!(after.channel(channel).iter().all(|value| *value == 0.0)),
                    false => assert_eq!(before.channel(channel), after.channel(channel)),
                }
            }
            forgotten += usize::from(hidden);
        }
        assert!((150..250).contains(&forgotten), "{forgotten}");
        // Without beat features, `bar_drop_prob` has no effect.
        let without = synthetic::phrase(4, 30, 2);
        let samples = [&plain, &dropping].map(|sampler| sampler.sample(&alone(&without), 1));
        assert_eq!(samples[0], samples[1]);
    }

    fn sampler(change: impl Fn(&mut DataConfig)) -> Augmentation {
        let mut config = DataConfig {
            target_frames: 20,
            ..DataConfig::default()
        };
        change(&mut config);
        Augmentation::new(&config, 3)
    }

    /// A phrase without neighbors in its recording.
    fn alone(phrase: &PhraseItem) -> ContextWindow {
        ContextWindow::alone(Arc::new(phrase.clone()))
    }

    /// The first frame of the sample's audio in `phrase`.
    fn start(phrase: &PhraseItem, audio: &AudioFeatures) -> usize {
        (0..=phrase.frames() - audio.frames())
            .find(|&s| phrase.audio.slice(s..s + audio.frames()) == *audio)
            .expect("a window of the phrase")
    }

    #[test]
    fn without_crop_and_augmentation_a_sample_is_the_phrase_as_stored() {
        for (frames, crop) in [(20, Crop::Random), (12, Crop::Random), (50, Crop::Leading)] {
            let phrase = synthetic::phrase(0, frames, 1);
            let (motion, audio) = sampler(|config| config.crop = crop).sample(&alone(&phrase), 7);
            assert_eq!(motion, phrase.motion.slice(0..frames.min(20)));
            assert_eq!(audio, phrase.audio.slice(0..frames.min(20)));
        }
    }

    #[test]
    fn random_crops_reach_every_window_and_stand_at_the_origin() {
        let phrase = synthetic::phrase(0, 24, 1);
        let sampler = sampler(|_| {});
        let mut starts = BTreeSet::new();
        for n in 0..100 {
            let (motion, audio) = sampler.sample(&alone(&phrase), n);
            let s = start(&phrase, &audio);
            starts.insert(s);
            let mut expected = phrase.motion.slice(s..s + 20);
            if s > 0 {
                anchor_floor(&mut expected);
            }
            assert_eq!(motion, expected);
            assert_eq!(motion.vector(0, POSITION)[0], 0.0);
            assert_eq!(sampler.sample(&alone(&phrase), n), (motion, audio));
        }
        assert_eq!(starts, (0..=4).collect());
    }

    #[test]
    fn short_windows_keep_the_minimum_and_vary() {
        let phrase = synthetic::phrase(0, 40, 1);
        let sampler = sampler(|config| config.augment.min_frames = Some(15));
        let mut seen = BTreeSet::new();
        for n in 0..300 {
            let (motion, audio) = sampler.sample(&alone(&phrase), n);
            assert_eq!(motion.frames(), audio.frames());
            assert!((15..=20).contains(&motion.frames()));
            let [x, _, z] = motion.vector(0, POSITION);
            assert_eq!((x, z), (0.0, 0.0));
            seen.insert((motion.frames(), start(&phrase, &audio)));
        }
        assert_eq!(
            seen.iter()
                .map(|(length, _)| length)
                .collect::<BTreeSet<_>>()
                .len(),
            6
        );
        assert!(seen.len() > 60, "{}", seen.len());
        let short = synthetic::phrase(0, 10, 1);
        assert_eq!(sampler.sample(&alone(&short), 0).0.frames(), 10);
    }

    #[test]
    fn turned_and_mirrored_samples_stay_motions_and_keep_their_music() {
        let phrase = synthetic::phrase(0, 20, 1);
        let both = sampler(|config| {
            config.augment.rotate_yaw = true;
            config.augment.mirror = true;
        });
        let mirrored = sampler(|config| config.augment.mirror = true);
        let mut kinds = BTreeSet::new();
        for n in 0..40 {
            let (motion, audio) = both.sample(&alone(&phrase), n);
            assert_eq!(audio, phrase.audio);
            assert_ne!(motion, phrase.motion);
            assert!(mean_norm(&velocity_errors(&motion)) < 1e-4);
            kinds.insert(mirrored.sample(&alone(&phrase), n).0 == phrase.motion);
        }
        assert_eq!(kinds.len(), 2, "both sides come up");
    }

    #[test]
    fn audio_noise_has_its_deviation_and_leaves_the_motion() {
        let phrase = synthetic::phrase(0, 20, 1);
        let (motion, audio) =
            sampler(|config| config.augment.audio_noise = 0.25).sample(&alone(&phrase), 4);
        assert_eq!(motion, phrase.motion);
        let differences = audio.as_slice().iter().zip(phrase.audio.as_slice());
        let square: f64 = differences.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        let std = (square / audio.as_slice().len() as f64).sqrt();
        assert!((std - 0.25).abs() < 0.015, "{std}");
    }

    #[test]
    fn replaced_audio_is_noise_and_the_rest_is_untouched() {
        let phrase = synthetic::phrase(0, 20, 1);
        let replacing = sampler(|config| config.augment.audio_replace_prob = 0.5);
        let mut replaced = 0;
        for n in 0..60 {
            let (motion, audio) = replacing.sample(&alone(&phrase), n);
            assert_eq!(motion, phrase.motion);
            if audio != phrase.audio {
                replaced += 1;
                let values = audio.as_slice();
                let square: f32 = values.iter().map(|v| v * v).sum();
                assert!((square / values.len() as f32 - 1.0).abs() < 0.15);
            }
        }
        assert!((15..45).contains(&replaced), "{replaced} of 60");
    }

    #[test]
    fn flipped_quaternions_are_the_same_orientations() {
        let phrase = synthetic::phrase(0, 20, 1);
        let flipping = sampler(|config| config.augment.flip_quaternion = true);
        let mut flipped = 0;
        for n in 0..40 {
            let (motion, audio) = flipping.sample(&alone(&phrase), n);
            assert_eq!(audio, phrase.audio);
            let sign = motion
                .quaternion(0)
                .dot(phrase.motion.quaternion(0))
                .signum();
            flipped += usize::from(sign < 0.0);
            for t in 0..20 {
                let (a, b) = (
                    motion.quaternion(t),
                    phrase.motion.quaternion(t).scale(sign),
                );
                assert_eq!((a.w, a.x, a.y, a.z), (b.w, b.x, b.y, b.z));
            }
        }
        assert!((10..30).contains(&flipped), "{flipped} of 40");
    }

    #[test]
    fn audio_masks_zero_stretches_and_bands_and_leave_the_rest() {
        let phrase = PhraseItem {
            audio: AudioFeatures::new(20, vec![1.0; AUDIO_CHANNELS * 20]).expect("a size"),
            ..synthetic::phrase(0, 20, 1)
        };
        let masking = sampler(|config| config.augment.audio_masks = 1);
        let mut masked = 0.0;
        for n in 0..100 {
            let (motion, audio) = masking.sample(&alone(&phrase), n);
            assert_eq!(motion, phrase.motion);
            let silent = |t: usize| (0..AUDIO_CHANNELS).all(|c| audio.channel(c)[t] == 0.0);
            let frames = (0..20).filter(|&t| silent(t)).count();
            let dark = (0..AUDIO_CHANNELS).filter(|&c| audio.channel(c).iter().all(|v| *v == 0.0));
            let channels = dark.count();
            assert!(
                frames <= 4 && channels <= AUDIO_CHANNELS / 4,
                "{frames} {channels}"
            );
            let plain = audio.as_slice().iter().filter(|v| **v == 1.0).count();
            assert_eq!(plain, (20 - frames) * (AUDIO_CHANNELS - channels));
            masked += 1.0 - plain as f64 / (20 * AUDIO_CHANNELS) as f64;
        }
        assert!(
            (5.0..40.0).contains(&masked),
            "{masked} % masked on average"
        );
    }

    #[test]
    fn audio_masks_leave_beats() {
        let phrase = synthetic::phrase_in(AudioLayout::WITH_BEATS, 3, 60, 2);
        let features = |masks: usize, n: u64| {
            let masking = sampler(|config| config.augment.audio_masks = masks);
            let (_, audio) = masking.sample(&alone(&phrase), n);
            let rows = AUDIO_CHANNELS * audio.frames();
            (
                audio.as_slice()[..rows].to_vec(),
                audio.as_slice()[rows..].to_vec(),
            )
        };
        for n in 0..20 {
            let ((features, beats), (masked, left)) = (features(0, n), features(4, n));
            assert_eq!(left, beats);
            assert_ne!(masked, features);
        }
    }

    #[test]
    fn faster_and_slower_samples_move_and_sound_together() {
        use kinegrad_motion::circular::{distance, step};
        use kinegrad_motion::phrase::PHASE;

        let phrase = synthetic::phrase_in(AudioLayout::WITH_BEATS, 3, 60, 2);
        let playing = sampler(|config| config.augment.speed = 0.6);
        let (mut slow, mut fast, mut starts) = (0, 0, BTreeSet::new());
        for n in 0..300 {
            let (motion, audio) = playing.sample(&alone(&phrase), n);
            assert_eq!((motion.frames(), audio.frames()), (20, 20));
            assert!(mean_norm(&velocity_errors(&motion)) < 1e-4);
            let place = |t: usize| {
                let [sine, cosine] = [2, 3].map(|row| audio.channel(AUDIO_CHANNELS + row)[t]);
                f64::from(sine.atan2(cosine)) / std::f64::consts::TAU
            };
            let phase = |t: usize| f64::from(motion.frame(t)[PHASE]);
            let offset = step(place(0), phase(0));
            for t in 0..20 {
                assert!(distance(place(t) + offset, phase(t)) < 1e-3, "{n} {t}");
            }
            let of = |m: &Phrase, from: usize| {
                step(
                    f64::from(m.frame(from)[PHASE]),
                    f64::from(m.frame(from + 1)[PHASE]),
                )
            };
            let speed = of(&motion, 5) / of(&phrase.motion, 5);
            assert!((0.62..1.61).contains(&speed), "{speed}");
            slow += usize::from(speed < 1.0);
            fast += usize::from(speed > 1.0);
            starts.insert((f64::from(motion.frame(0)[PHASE]) * 1e3) as i64);
        }
        assert!(
            slow > 110 && fast > 110 && starts.len() > 20,
            "{slow} {fast}"
        );
        // If the recording is too short for a higher speed, the sample is shorter.
        let short = synthetic::phrase(0, 21, 2);
        let lengths: BTreeSet<usize> = (0..60)
            .map(|n| playing.sample(&alone(&short), n).0.frames())
            .collect();
        assert!(lengths.contains(&20) && lengths.iter().any(|n| (13..17).contains(n)));
        assert!(lengths.iter().all(|n| (13..=20).contains(n)), "{lengths:?}");
    }

    #[test]
    fn switching_one_augmentation_on_moves_no_other() {
        let phrase = synthetic::phrase(0, 40, 1);
        let one = sampler(|config| config.augment.min_frames = Some(8));
        let two = sampler(|config| {
            config.augment.min_frames = Some(8);
            config.augment.rotate_yaw = true;
        });
        for n in 0..20 {
            assert_eq!(
                one.sample(&alone(&phrase), n).1,
                two.sample(&alone(&phrase), n).1
            );
        }
    }
}
