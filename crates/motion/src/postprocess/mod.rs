//! Post-processing of a generated phrase.
//!
//! Steps (CC-MotionGen, section 9.2; docs/sources.md, section 1.12):
//!
//! 1. values clamped
//! 2. quaternions normalized, with the sign of one hemisphere
//! 3. quaternions smoothed
//! 4. phase clamped, then made monotonic
//! 5. velocity, then acceleration, blended with the differences
//! 6. vectors and style smoothed over time
//! 7. the nearest coherent motion fitted (not in CC-MotionGen)
//! 8. angular velocity derived from the quaternions (not in CC-MotionGen)
//!
//! Steps 1 to 6 use double precision. The result is rounded once.

mod config;
mod orientation;

pub use config::{ClampLimits, Differences, Hemisphere, PostProcessConfig, PostProcessProfile};

use std::ops::Range;

use crate::coherence::{
    fit_heading, fit_orientation, fit_phase, fit_trajectory, heading_confidence,
};
use crate::phrase::{
    ACCELERATION, ANGULAR_VELOCITY, CHANNELS, FPS, PHASE, POSITION, QUATERNION, VELOCITY,
};
use crate::{Phrase, Statistics};

/// A phrase `[frames, 25]` in double precision.
type Frames = Vec<[f64; CHANNELS]>;

/// Post-processes a phrase. The training `statistics` widen limits and scale the coherent fit.
///
/// NaN stays NaN and prevents the fit. Infinities are clamped in channels with limits.
pub fn process(
    motion: &Phrase,
    config: &PostProcessConfig,
    statistics: Option<&Statistics>,
) -> Phrase {
    let (none, confidence) = (vec![false; motion.frames()], heading_confidence(motion));
    process_around(motion, config, statistics, &none, &confidence)
}

/// [`process`] with `known` frames, which the fit keeps, and the headings' `confidence`, 0 to 1.
pub fn process_around(
    motion: &Phrase,
    config: &PostProcessConfig,
    statistics: Option<&Statistics>,
    known: &[bool],
    confidence: &[f64],
) -> Phrase {
    assert_eq!(known.len(), motion.frames(), "known frames");
    let frames = (0..motion.frames()).map(|t| motion.frame(t));
    let frames = frames.map(|frame| std::array::from_fn(|c| f64::from(frame[c])));
    let mut frames: Frames = frames.collect();

    if config.clamp_values {
        clamp_values(&mut frames, config, statistics);
    }
    if config.normalize_quaternions {
        orientation::normalize(&mut frames, config);
    }
    if config.smooth_quaternions {
        orientation::smooth(&mut frames, config);
    }
    if config.clamp_phase {
        for frame in &mut frames {
            frame[PHASE] = clamp(frame[PHASE], config.phase_min, config.phase_max);
        }
    }
    if config.enforce_phase_monotonic {
        make_phase_monotonic(&mut frames);
    }
    let differences = config.differences;
    if config.enforce_velocity_coherence {
        blend_with_differences(&mut frames, POSITION, VELOCITY, differences);
    }
    if config.enforce_accel_coherence {
        blend_with_differences(&mut frames, VELOCITY, ACCELERATION, differences);
    }
    if config.apply_smoothing {
        smooth_over_time(&mut frames, config.smoothing_kernel_size);
    }

    let mut processed = motion.clone();
    for (t, frame) in frames.iter().enumerate() {
        for (stored, &value) in processed.frame_mut(t).iter_mut().zip(frame) {
            *stored = value as f32;
        }
    }
    if config.fit_coherent_motion
        && let Some(Statistics { std, .. }) = statistics
        && processed.first_non_finite().is_none()
    {
        let mut fitted = processed.clone();
        fit_trajectory(&mut fitted, std, known);
        fit_heading(&mut fitted, std, known, confidence);
        fit_orientation(&mut fitted, std, known);
        fit_phase(&mut fitted, known);
        if fitted.first_non_finite().is_none() {
            processed = fitted;
        }
    }
    if config.derive_angular_velocity {
        derive_angular_velocity(&mut processed);
    }
    processed
}

/// Derives the angular velocity from the quaternions, in frames with finite values.
pub fn derive_angular_velocity(motion: &mut Phrase) {
    let finite = |vector: [f64; 3]| vector.iter().all(|value| value.is_finite());
    let rates = crate::derivatives::angular_rates(motion);
    let last = rates.last().copied();
    for (t, rate) in rates.into_iter().chain(last).enumerate() {
        if finite(rate) && finite(motion.vector(t, ANGULAR_VELOCITY)) {
            motion.set_vector(t, ANGULAR_VELOCITY, rate);
        }
    }
}

fn clamp_values(frames: &mut Frames, config: &PostProcessConfig, statistics: Option<&Statistics>) {
    let range = statistics.and_then(|training| training.range.as_ref());
    let widest = range.filter(|_| config.widen_limits);
    let limits = &config.limits;
    let groups = [
        (POSITION, limits.position),
        (VELOCITY, limits.velocity),
        (ACCELERATION, limits.acceleration),
        (ANGULAR_VELOCITY, limits.angular_velocity),
    ];
    for (group, limit) in groups {
        for channel in group {
            let low = widest.map_or(-limit, |[min, _]| min[channel].min(-limit));
            let high = widest.map_or(limit, |[_, max]| max[channel].max(limit));
            for frame in frames.iter_mut() {
                frame[channel] = clamp(frame[channel], low, high);
            }
        }
    }
}

/// A drop of at most half a bar is a step back; a larger one is the next bar.
fn make_phase_monotonic(frames: &mut Frames) {
    for t in 1..frames.len() {
        let step = frames[t][PHASE] - frames[t - 1][PHASE];
        if (-0.5..0.0).contains(&step) {
            frames[t][PHASE] = frames[t - 1][PHASE];
        }
    }
}

/// Averages the `explicit` derivative with the difference of the vector `base`.
fn blend_with_differences(
    frames: &mut Frames,
    base: Range<usize>,
    explicit: Range<usize>,
    differences: Differences,
) {
    if frames.len() < 2 {
        return; // A single frame has no difference to blend with.
    }
    for (base, explicit) in base.zip(explicit) {
        let values: Vec<f64> = frames.iter().map(|frame| frame[base]).collect();
        for (t, frame) in frames.iter_mut().enumerate() {
            // The frame at the end uses the neighboring frame's difference.
            let next = match differences {
                Differences::Forward => (t + 1).min(values.len() - 1),
                Differences::Backward => t.max(1),
            };
            let difference = (values[next] - values[next - 1]) * FPS;
            frame[explicit] = 0.5 * (frame[explicit] + difference);
        }
    }
}

/// A centered mean over `kernel_size` frames, for all channels except quaternion and phase.
fn smooth_over_time(frames: &mut Frames, kernel_size: usize) {
    let original = frames.clone();
    let smoothed = |channel: &usize| !QUATERNION.contains(channel) && *channel != PHASE;
    for (t, frame) in frames.iter_mut().enumerate() {
        for channel in (0..CHANNELS).filter(smoothed) {
            let values = window(t, kernel_size, original.len()).map(|s| original[s][channel]);
            frame[channel] = values.sum::<f64>() / (2 * (kernel_size / 2) + 1) as f64;
        }
    }
}

/// Indices of the `size` frames (odd) centered at `t`, with the ends repeated.
fn window(t: usize, size: usize, frames: usize) -> impl Iterator<Item = usize> {
    let reach = size / 2;
    (0..2 * reach + 1).map(move |offset| (t + offset).saturating_sub(reach).min(frames - 1))
}

/// Unlike `f64::max`, this keeps NaN; unlike `f64::clamp`, this never panics.
fn clamp(value: f64, low: f64, high: f64) -> f64 {
    match value {
        _ if value < low => low,
        _ if value > high => high,
        _ => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Quaternion;
    use crate::derivatives::{mean_norm, velocity_errors};
    use crate::phrase::STYLE;
    use crate::random_phrase::random_phrase;

    fn wild(frames: usize) -> Phrase {
        let mut motion = random_phrase(8, frames);
        for t in 0..frames {
            motion.set_vector(t, POSITION, [150.0, -20.0, -101.0]);
            motion.set_vector(t, VELOCITY, [49.0, 51.0, -1e9]);
            motion.set_vector(t, ACCELERATION, [101.0, 0.0, f64::INFINITY]);
            motion.set_vector(t, ANGULAR_VELOCITY, [-12.0, 9.0, 31.0]);
            motion.frame_mut(t)[PHASE] = 1.5;
        }
        motion
    }

    #[test]
    fn the_defaults_leave_a_sound_phrase_alone() {
        let motion = random_phrase(1, 60);
        let processed = process(&motion, &PostProcessConfig::default(), None);
        let pairs = processed.as_slice().iter().zip(motion.as_slice());
        for (index, (after, before)) in pairs.enumerate() {
            // The rounding error of quaternions, times the frame rate.
            let turns = ANGULAR_VELOCITY.contains(&(index % CHANNELS));
            let allowed = if turns { 3e-5 } else { 2e-7 };
            assert!((after - before).abs() < allowed, "{after} {before}");
        }
    }

    #[test]
    fn the_angular_velocity_is_that_of_the_written_quaternions() {
        let mut motion = random_phrase(5, 31);
        for t in 0..31 {
            // Short quaternions of both signs, and an unrelated angular velocity.
            let sign = if t % 3 == 0 { -0.6 } else { 0.6 };
            motion.set_quaternion(t, motion.quaternion(t).scale(sign));
            motion.set_vector(t, ANGULAR_VELOCITY, [1.0, -2.0, 0.5]);
        }
        let error = |motion: &Phrase| mean_norm(&crate::derivatives::rotation_errors(motion));
        let literal = process(&motion, &PostProcessConfig::ccmotion(), None);
        assert!(error(&literal) > 1.0);
        assert_eq!(literal.vector(7, ANGULAR_VELOCITY), [1.0, -2.0, 0.5]);
        let processed = process(&motion, &PostProcessConfig::default(), None);
        assert!(error(&processed) < 1e-6, "{}", error(&processed));
        let last = processed.vector(30, ANGULAR_VELOCITY);
        assert_eq!(last, processed.vector(29, ANGULAR_VELOCITY));

        let single = motion.slice(0..1);
        let processed = process(&single, &PostProcessConfig::default(), None);
        assert_eq!(processed.vector(0, ANGULAR_VELOCITY), [1.0, -2.0, 0.5]);
        motion.frame_mut(4)[ANGULAR_VELOCITY.start] = f32::NAN;
        let processed = process(&motion, &PostProcessConfig::default(), None);
        assert_eq!(
            processed.first_non_finite(),
            Some((4, ANGULAR_VELOCITY.start))
        );
    }

    #[test]
    fn clamps_are_never_tighter_than_the_training_range() {
        let motion = wild(3);
        let clamped = PostProcessConfig {
            fit_coherent_motion: false,
            derive_angular_velocity: false,
            ..PostProcessConfig::default()
        };
        let bare = process(&motion, &clamped, None);
        assert_eq!(bare.vector(1, POSITION), [100.0, -20.0, -100.0]);
        assert_eq!(bare.vector(1, VELOCITY), [49.0, 50.0, -50.0]);
        assert_eq!(bare.vector(1, ACCELERATION), [100.0, 0.0, 100.0]);
        assert_eq!(bare.vector(1, ANGULAR_VELOCITY), [-10.0, 9.0, 10.0]);
        assert_eq!(bare.frame(1)[PHASE], 1.0);

        let mut training = random_phrase(2, 3);
        training.set_vector(0, ANGULAR_VELOCITY, [0.0, 0.0, 20.0]);
        training.set_vector(1, ANGULAR_VELOCITY, [-30.0, 0.0, 0.0]);
        let statistics = crate::phrase_statistics([&training]).unwrap();
        let wide = process(&motion, &clamped, Some(&statistics));
        assert_eq!(wide.vector(1, ANGULAR_VELOCITY), [-12.0, 9.0, 20.0]);
        assert_eq!(wide.vector(1, VELOCITY), [49.0, 50.0, -50.0]);
        let literal = process(&motion, &PostProcessConfig::ccmotion(), Some(&statistics));
        assert_eq!(literal.vector(1, ANGULAR_VELOCITY), [-10.0, 9.0, 10.0]);
    }

    #[test]
    fn switched_off_is_untouched() {
        let motion = wild(5);
        assert_eq!(process(&motion, &PostProcessConfig::none(), None), motion);
    }

    #[test]
    fn backward_phase_is_clamped_and_the_next_bar_begins() {
        let mut motion = random_phrase(4, 6);
        for (t, phase) in [0.8, 0.7, 0.75, 0.9, 0.2, 0.1].into_iter().enumerate() {
            motion.frame_mut(t)[PHASE] = phase;
        }
        let config = PostProcessConfig {
            enforce_phase_monotonic: true,
            ..PostProcessConfig::default()
        };
        let processed = process(&motion, &config, None);
        let phases: Vec<f32> = (0..6).map(|t| processed.frame(t)[PHASE]).collect();
        assert_eq!(phases, [0.8, 0.8, 0.8, 0.9, 0.2, 0.2]);
    }

    #[test]
    fn coherence_blends_half_of_the_backward_difference() {
        let mut motion = random_phrase(4, 3);
        for (t, x) in [0.0, 1.0, 3.0].into_iter().enumerate() {
            motion.set_vector(t, POSITION, [x, 0.0, 0.0]);
            motion.set_vector(t, VELOCITY, [10.0, 0.0, 0.0]);
            motion.set_vector(t, ACCELERATION, [0.0; 3]);
        }
        let config = PostProcessConfig {
            enforce_velocity_coherence: true,
            enforce_accel_coherence: true,
            differences: Differences::Backward,
            ..PostProcessConfig::none()
        };
        let processed = process(&motion, &config, None);
        let x = |channels: std::ops::Range<usize>| {
            [0, 1, 2].map(|t| processed.vector(t, channels.clone())[0])
        };
        assert_eq!(x(VELOCITY), [20.0, 20.0, 35.0]);
        assert_eq!(x(ACCELERATION), [0.0, 0.0, 225.0]);
    }

    #[test]
    fn forward_differences_halve_what_the_checks_measure() {
        let mut motion = random_phrase(4, 30);
        for t in 0..30 {
            let v = motion.vector(t, VELOCITY);
            let wrong = if t % 3 == 0 { 0.9 } else { -0.4 };
            motion.set_vector(t, VELOCITY, v.map(|v| v + wrong));
        }
        let config = PostProcessConfig {
            enforce_velocity_coherence: true,
            ..PostProcessConfig::none()
        };
        let error = |motion: &Phrase| mean_norm(&velocity_errors(motion));
        let processed = process(&motion, &config, None);
        assert!((error(&processed) / error(&motion) - 0.5).abs() < 1e-3);
    }

    #[test]
    fn smoothing_is_a_centred_mean_of_vectors_and_style() {
        let mut motion = random_phrase(4, 4);
        for (t, value) in [0.0, 3.0, 6.0, 12.0].into_iter().enumerate() {
            motion.set_vector(t, POSITION, [value; 3]);
            motion.frame_mut(t)[STYLE.end - 1] = value as f32;
        }
        let config = PostProcessConfig {
            apply_smoothing: true,
            ..PostProcessConfig::none()
        };
        let processed = process(&motion, &config, None);
        for (t, mean) in [1.0, 3.0, 7.0, 10.0].into_iter().enumerate() {
            assert_eq!(processed.vector(t, POSITION), [mean; 3]);
            assert_eq!(processed.frame(t)[STYLE.end - 1], mean as f32);
            assert_eq!(processed.frame(t)[PHASE], motion.frame(t)[PHASE]);
            assert_eq!(processed.quaternion(t), motion.quaternion(t));
        }
    }

    #[test]
    fn short_phrases_and_odd_settings_do_not_panic() {
        let everything = PostProcessConfig {
            smooth_quaternions: true,
            enforce_phase_monotonic: true,
            enforce_velocity_coherence: true,
            enforce_accel_coherence: true,
            apply_smoothing: true,
            ..PostProcessConfig::default()
        };
        for frames in 1..4 {
            let motion = random_phrase(6, frames);
            for (kernel, limit) in [(0, -1.0), (1, f64::NAN), (8, 0.0)] {
                let config = PostProcessConfig {
                    quaternion_smoothing_window: kernel,
                    smoothing_kernel_size: kernel,
                    limits: ClampLimits {
                        position: limit,
                        ..ClampLimits::default()
                    },
                    ..everything.clone()
                };
                assert_eq!(process(&motion, &config, None).frames(), frames);
                config.validate().unwrap_err();
            }
        }
        assert_eq!(everything.validate(), Ok(()));
    }

    #[test]
    fn nan_is_not_hidden() {
        let mut motion = random_phrase(6, 5);
        let channels = 0..CHANNELS;
        channels
            .clone()
            .for_each(|channel| motion.frame_mut(2)[channel] = f32::NAN);
        for config in [PostProcessConfig::default(), PostProcessConfig::ccmotion()] {
            let processed = process(&motion, &config, None);
            assert!(
                channels
                    .clone()
                    .all(|channel| processed.frame(2)[channel].is_nan())
            );
            assert_eq!(processed.slice(0..2).first_non_finite(), None);
            assert_eq!(processed.slice(3..5).first_non_finite(), None);
        }
    }

    #[test]
    fn a_vanishing_quaternion_repeats_the_one_before() {
        let mut motion = random_phrase(6, 3);
        motion.set_quaternion(1, Quaternion::new(0.0, 1e-12, 0.0, 0.0));
        let processed = process(&motion, &PostProcessConfig::default(), None);
        assert_eq!(processed.quaternion(1), processed.quaternion(0));
        assert!(processed.quaternion(1).dot(processed.quaternion(2)) > 0.9);
    }
}
