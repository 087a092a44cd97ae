use burn::tensor::{Device, Tensor, TensorData};

use super::{TemporalLossConfig, temporal_losses};

/// The terms of `motion [batch, time, 25]` without padding.
fn terms(motion: &Tensor<3>, config: &TemporalLossConfig) -> Vec<(&'static str, Tensor<1>)> {
    let [batch, time, _] = motion.dims();
    let mask = Tensor::ones([batch, time], &motion.device());
    temporal_losses(&motion.clone().swap_dims(1, 2), &mask, config)
}

fn value(term: &Tensor<1>) -> f64 {
    f64::from(term.clone().into_scalar::<f32>())
}

/// Every term, including terms that are not in CC-MotionGen.
fn all_terms() -> TemporalLossConfig {
    TemporalLossConfig {
        quat_norm_weight: 1.0,
        angular_velocity_weight: 1.0,
        position_smoothness_weight: 1.0,
        position_jerk_weight: 1.0,
        ..TemporalLossConfig::default()
    }
}

/// A motion `[1, 8, 25]` at rest with the given quaternions.
fn turning(quaternions: [[f32; 4]; 8]) -> Tensor<3> {
    let mut values = vec![0.0; 8 * 25];
    for (frame, quaternion) in values.chunks_mut(25).zip(quaternions) {
        frame[9..13].copy_from_slice(&quaternion);
    }
    Tensor::from_data(
        TensorData::new(values, [1, 8, 25]),
        &Device::flex().autodiff(),
    )
}

#[test]
fn gradients_are_finite_where_formulas_are_not() {
    let unit = [1.0, 0.0, 0.0, 0.0];
    let antipodal = [-1.0, 0.0, 0.0, 0.0];
    let half_turn = [0.0, 1.0, 0.0, 0.0];
    let cases = [
        [unit; 8],
        [
            unit, antipodal, unit, antipodal, unit, antipodal, unit, antipodal,
        ],
        [
            unit, half_turn, unit, half_turn, unit, half_turn, unit, half_turn,
        ],
        [[0.0; 4]; 8],
    ];
    for quaternions in cases {
        let motion = turning(quaternions).require_grad();
        let total = terms(&motion, &all_terms()).into_iter().map(|(_, t)| t);
        let total = total.reduce(|a, b| a + b).expect("terms");
        assert!(value(&total).is_finite());
        let gradient = motion.grad(&total.backward()).expect("a gradient");
        let gradient = gradient.try_into_vec_as::<f32>().expect("float32");
        assert!(gradient.iter().all(|g| g.is_finite()), "{quaternions:?}");
    }
}

#[test]
fn angular_velocity_agrees_with_that_of_the_phrases() {
    use kinegrad_motion::{Quaternion, derivatives};
    let quaternions: Vec<Quaternion> = (0..8)
        .map(|t| {
            let angle = 0.4 * f64::from(t * t) / 8.0;
            let axis = [0.6, 0.0, 0.8].map(|c| c * angle);
            Quaternion::from_rotation_vector(axis)
        })
        .collect();
    let turns = derivatives::angular_velocity(&quaternions, 30.0);
    let mut values = vec![0.0f32; 8 * 25];
    for (t, frame) in values.chunks_mut(25).enumerate() {
        let q = quaternions[t];
        // Every second quaternion is negated: the rotation is the same.
        let sign = if t % 2 == 0 { 1.0 } else { -1.0 };
        for (value, part) in frame[9..13].iter_mut().zip([q.w, q.x, q.y, q.z]) {
            *value = (sign * part) as f32;
        }
        for (value, part) in frame[13..16].iter_mut().zip(turns[t]) {
            *value = part as f32;
        }
    }
    let motion = Tensor::from_data(TensorData::new(values, [1, 8, 25]), &Device::flex());
    let error = terms(&motion, &all_terms())
        .into_iter()
        .find(|(name, _)| *name == "angular_velocity");
    assert!(value(&error.expect("a term").1) < 1e-9);
}

#[test]
fn padding_does_not_count() {
    let motion = turning([[1.0, 0.2, -0.3, 0.1]; 8]);
    let noise = Tensor::<3>::ones([1, 4, 25], &motion.device()) * 3.0;
    let padded = Tensor::cat(vec![motion.clone(), noise], 1);
    let mut mask = vec![1.0f32; 8];
    mask.resize(12, 0.0);
    let mask = Tensor::from_data(TensorData::new(mask, [1, 12]), &motion.device());
    let found = temporal_losses(&padded.swap_dims(1, 2), &mask, &all_terms());
    for ((name, expected), (_, found)) in terms(&motion, &all_terms()).iter().zip(&found) {
        assert!((value(expected) - value(found)).abs() < 1e-7, "{name}");
    }
}

/// No term but those with the given weights.
fn alone(quat_norm_weight: f64, position_jerk_weight: f64) -> TemporalLossConfig {
    TemporalLossConfig {
        velocity_weight: 0.0,
        acceleration_weight: 0.0,
        jerk_weight: 0.0,
        quat_delta_weight: 0.0,
        phase_monotonic_weight: 0.0,
        angular_velocity_weight: 0.0,
        quat_norm_weight,
        position_jerk_weight,
        // A large target, so that a jerk of some meters per frame cubed is near 1.
        target_jerk: 27_000.0,
        ..TemporalLossConfig::default()
    }
}

const FRAMES: usize = 9;

/// Two samples of [`FRAMES`] frames with values `of(sample, frame, channel)`.
fn motion(of: impl Fn(usize, usize, usize) -> f64) -> Vec<f32> {
    let mut values = Vec::new();
    for sample in 0..2 {
        for frame in 0..FRAMES {
            values.extend((0..25).map(|channel| of(sample, frame, channel) as f32));
        }
    }
    values
}

/// The single term of `config` on two samples, and its gradient; the second sample has `real` real
/// frames.
fn only(values: &[f32], real: usize, config: &TemporalLossConfig) -> (f64, Vec<f32>) {
    let device = Device::flex().autodiff();
    let data = TensorData::new(values.to_vec(), [2, FRAMES, 25]);
    let motion = Tensor::<3>::from_data(data, &device).require_grad();
    let mut mask = vec![1.0f32; 2 * FRAMES];
    mask[FRAMES + real..].fill(0.0);
    let mask = Tensor::from_data(TensorData::new(mask, [2, FRAMES]), &device);
    let found = temporal_losses(&motion.clone().swap_dims(1, 2), &mask, config);
    let [(_, term)] = &found[..] else {
        panic!("{} terms", found.len());
    };
    let gradient = motion.grad(&term.backward()).expect("a gradient");
    let gradient = gradient.try_into_vec_as::<f32>().expect("float32");
    (value(term), gradient)
}

/// Asserts that the gradient equals the slope of the term in each of `channels`, and is 0
/// elsewhere.
fn assert_gradient(
    values: &[f32],
    real: usize,
    config: &TemporalLossConfig,
    channels: std::ops::Range<usize>,
    step: f32,
) {
    let (_, gradient) = only(values, real, config);
    let largest = gradient.iter().fold(0.0f32, |m, g| m.max(g.abs()));
    assert!(largest > 0.0, "a motion with a slope");
    for (place, gradient) in gradient.iter().enumerate() {
        if !channels.contains(&(place % 25)) {
            assert_eq!(*gradient, 0.0, "at {place}");
            continue;
        }
        let moved = |by: f32| {
            let mut values = values.to_vec();
            values[place] += by;
            only(&values, real, config).0
        };
        let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
        let error = (slope - f64::from(*gradient)).abs() / f64::from(largest);
        assert!(error < 1e-3, "at {place}: {gradient} for {slope}");
    }
}

/// Positions `c t^3 + d t^2 + e t` over frames have the third difference `6 c` for any d and e.
#[test]
fn position_jerk_is_the_squared_third_difference() {
    let cubic = [[1.0, -2.0, 3.0], [0.5, 0.0, -1.0]];
    let path = |sample: usize, frame: usize, channel: usize| {
        let t = frame as f64;
        match channel {
            0..3 => cubic[sample][channel] * t.powi(3) + 4.0 * t.powi(2) - 3.0 * t,
            // Other channels of a motion are ignored.
            _ => 7.0 * (t + channel as f64).sin(),
        }
    };
    // At 30 frames per second: 27000 (6 c) meters per second cubed, divided by the target.
    let of = |sample: usize| -> f64 { cubic[sample].iter().map(|c| (6.0 * c).powi(2)).sum() };
    let weight = 2.5;
    let config = alone(0.0, weight);
    let values = motion(path);
    let (found, _) = only(&values, FRAMES, &config);
    let expected = weight * (of(0) + of(1)) / 2.0;
    assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
    // 7 real frames have 4 third differences, 9 frames have 6.
    let (found, _) = only(&values, 7, &config);
    let expected = weight * (6.0 * of(0) + 4.0 * of(1)) / 10.0;
    assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");

    // The term is quadratic, so central differences of any step equal its slopes.
    assert_gradient(&values, 7, &config, 0..3, 4.0);
}

/// CC-MotionGen, section 14.1: `relu(|d p| - 0.5)`, the mean over frames and coordinates.
#[test]
fn position_smoothness_is_the_excess_of_each_step_over_the_threshold() {
    // Meters per frame: of three coordinates, one at the threshold, one beyond it in either sign.
    let steps = [[0.5, 0.75, -1.5], [0.1, -0.2, 0.625]];
    let path = |sample: usize, frame: usize, channel: usize| match channel {
        0..3 => steps[sample][channel] * frame as f64,
        _ => 7.0 * (frame as f64 + channel as f64).sin(),
    };
    let of = |sample: usize, threshold: f64| -> f64 {
        let excess = steps[sample]
            .iter()
            .map(|step: &f64| step.abs() - threshold);
        excess.map(|excess| excess.max(0.0)).sum::<f64>() / 3.0
    };
    let weight = 2.5;
    let mut config = TemporalLossConfig {
        position_smoothness_weight: weight,
        ..alone(0.0, 0.0)
    };
    assert_eq!(config.position_smoothness_threshold, 0.5);
    let values = motion(path);
    for threshold in [0.5, 0.7] {
        config.position_smoothness_threshold = threshold;
        // 7 real frames have 6 steps, 9 frames have 8.
        let (found, _) = only(&values, 7, &config);
        let expected = weight * (8.0 * of(0, threshold) + 6.0 * of(1, threshold)) / 14.0;
        assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
    }
    // The term is linear beyond the threshold.
    assert_gradient(&values, 7, &config, 0..3, 0.01);
    // Steps of real motion, 3 m/s, are free.
    let slow = motion(|sample, frame, channel| path(sample, frame, channel) / 15.0);
    assert_eq!(only(&slow, FRAMES, &config).0, 0.0);
}

/// Quaternions with one norm per sample, in changing directions.
#[test]
fn quat_norm_is_the_squared_excess_of_the_squared_length() {
    let lengths = [1.1, 0.6];
    let turning = |sample: usize, frame: usize, channel: usize| {
        let angle = 0.3 * frame as f64 + sample as f64;
        let direction = [
            0.8 * angle.cos(),
            0.8 * angle.sin(),
            0.6 * (2.0 * angle).cos(),
            0.6 * (2.0 * angle).sin(),
        ];
        match channel {
            9..13 => lengths[sample] * direction[channel - 9],
            _ => 7.0 * angle.sin(),
        }
    };
    // (1.1^2 - 1)^2 and (0.6^2 - 1)^2.
    let of = [0.0441, 0.4096];
    let weight = 2.5;
    let config = alone(weight, 0.0);
    let values = motion(turning);
    let (found, _) = only(&values, FRAMES, &config);
    let expected = weight * (of[0] + of[1]) / 2.0;
    assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
    let (found, _) = only(&values, 6, &config);
    let expected = weight * (9.0 * of[0] + 6.0 * of[1]) / 15.0;
    assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");

    assert_gradient(&values, 6, &config, 9..13, 0.01);
}
