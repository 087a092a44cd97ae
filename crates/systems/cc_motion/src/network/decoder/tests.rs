use burn::tensor::{Device, TensorData};
use kinegrad_kernels::{Mode, host_values};
use kinegrad_motion::phrase::{ACCELERATION, PHASE, POSITION, VELOCITY};
use kinegrad_motion::{OrientationEncoding, PhaseEncoding, Phrase, Quaternion, derivatives};
use kinegrad_random::{Key, Purpose};

use super::*;

fn normalization() -> Normalization {
    let mut mean: Vec<f64> = (0..CHANNELS).map(|c| 0.1 * c as f64 - 1.0).collect();
    let mut std: Vec<f64> = (0..CHANNELS).map(|c| 0.5 + 0.1 * c as f64).collect();
    mean[QUATERNION].fill(0.0);
    std[QUATERNION].fill(1.0);
    (mean[PHASE], std[PHASE]) = (0.5, 0.5);
    Normalization { mean, std }
}

fn decoder(coherence: Coherence, device: &Device) -> MotionDecoder {
    let config = DecoderConfig {
        hidden_dim: 40,
        coherence,
        ..Default::default()
    };
    config
        .init(normalization(), &Initializer::new(3, device))
        .unwrap()
}

fn latent(seed: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn largest(x: Tensor<3>) -> f32 {
    x.abs().max().into_scalar()
}

#[test]
fn a_fresh_decoder_undoes_the_normalisation() {
    let device = Device::flex();
    let x = latent(1, [2, CHANNELS, 7], &device) * 0.3;
    let found = host_values(decoder(Coherence::None, &device).forward(x.clone(), None));
    let (mean, std) = (normalization().mean, normalization().std);
    let x = host_values(x);
    for (index, (found, x)) in found.iter().zip(&x).enumerate() {
        let channel = index / 7 % CHANNELS;
        let expected = f64::from(*x) * std[channel] + mean[channel];
        let allowed = match channel {
            c if QUATERNION.contains(&c) => continue,
            c if VELOCITY.contains(&c) => 2e-3,
            PHASE => 0.1,
            _ => 1e-5,
        };
        let error = (f64::from(*found) - expected).abs();
        assert!(error < allowed, "channel {channel}: {found} for {expected}");
    }
}

#[test]
fn projected_motion_is_coherent_and_keeps_its_sign() {
    for coherence in [Coherence::Projection, Coherence::Full] {
        assert_coherent(coherence);
    }
}

fn assert_coherent(coherence: Coherence) {
    let device = Device::flex();
    let time = 9;
    let decoder = decoder(coherence, &device);
    let y = decoder.forward(latent(2, [3, CHANNELS, time], &device), None);
    assert_eq!(y.dims(), [3, CHANNELS, time]);
    let part = |range: std::ops::Range<usize>| y.clone().slice([0..3, range]);
    for (of, derivative) in [(POSITION, VELOCITY), (VELOCITY, ACCELERATION)] {
        let error = part(derivative).narrow(2, 0, time - 1) - differences(part(of));
        assert!(largest(error) < 1e-3, "{:?}", host_values(y.clone()));
    }
    let q = part(QUATERNION);
    let dots = (q.clone().narrow(2, 1, time - 1) * q.clone().narrow(2, 0, time - 1)).sum_dim(1);
    assert!(dots.min().into_scalar::<f32>() >= 0.0);
    let norms = q.square().sum_dim(1);
    assert!(largest(norms - 1.0) < 1e-5);
    // The angular velocity is the derivative of the written quaternions, according to the checks'
    // code.
    let rows = host_values(y.clone().swap_dims(1, 2));
    for rows in rows.chunks_exact(time * CHANNELS) {
        let motion = Phrase::new(rows.to_vec()).unwrap();
        let errors = derivatives::rotation_errors(&motion);
        assert!(derivatives::mean_norm(&errors) < 1e-4, "{errors:?}");
        let last = motion.vector(time - 1, ANGULAR_VELOCITY);
        assert_eq!(last, motion.vector(time - 2, ANGULAR_VELOCITY));
    }
    // Projecting coherent motion changes nothing.
    assert!(largest(decoder.project(y.clone()) - y) < 2e-2);
}

#[test]
fn one_frame_has_the_angular_velocity_of_its_head() {
    let device = Device::flex();
    let x = latent(2, [2, CHANNELS, 1], &device);
    let part = |coherence| {
        let y = decoder(coherence, &device).forward(x.clone(), None);
        host_values(y.slice([0..2, ANGULAR_VELOCITY]))
    };
    assert_eq!(part(Coherence::Projection), part(Coherence::None));
}

#[test]
fn gradients_stay_finite_at_a_vanishing_quaternion() {
    for coherence in [Coherence::Projection, Coherence::Full] {
        assert_finite_gradients(coherence);
    }
}

fn assert_finite_gradients(coherence: Coherence) {
    let device = Device::flex().autodiff();
    let decoder = decoder(coherence, &device);
    let x = Tensor::<3>::zeros([1, CHANNELS, 4], &device).require_grad();
    let gradients = decoder.forward(x.clone(), None).square().sum().backward();
    let gradient = x.grad(&gradients).expect("a gradient");
    assert!(host_values(gradient).iter().all(|g| g.is_finite()));
}

#[test]
fn bad_sizes_are_refused_by_key() {
    let cases = [
        (
            DecoderConfig {
                hidden_dim: 24,
                ..Default::default()
            },
            "decoder.hidden_dim` is 24",
        ),
        (
            DecoderConfig {
                dropout: 1.0,
                ..Default::default()
            },
            "decoder.dropout` is 1",
        ),
        (
            DecoderConfig {
                output_ranges: OutputRanges {
                    velocity: 0.0,
                    ..Default::default()
                },
                ..Default::default()
            },
            "decoder.output_ranges.velocity` is 0",
        ),
    ];
    for (config, expected) in cases {
        let text = config.validate().unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn a_fresh_decoder_of_other_targets_undoes_normalisation_and_conversion() {
    let device = Device::flex();
    let targets = ChannelEncoding {
        phase: PhaseEncoding::SinCos,
        orientation: OrientationEncoding::Rotation6d,
    };
    let channels = targets.channels();
    let (batch, time) = (2, 7);
    let normalization = Normalization {
        mean: vec![0.0; channels],
        std: vec![1.0; channels],
    };
    for coherence in [Coherence::None, Coherence::Projection, Coherence::Full] {
        let config = DecoderConfig {
            hidden_dim: 40,
            coherence,
            ..Default::default()
        };
        let init = Initializer::new(3, &device);
        let decoder = config
            .init_for(targets, normalization.clone(), &init)
            .unwrap();
        let x = latent(1, [batch, channels, time], &device) * 0.3;
        let expected = host_values(crate::network::channel_encoding::decode(targets, x.clone()));
        let found = host_values(decoder.forward(x, None));
        assert_eq!(found.len(), batch * CHANNELS * time);
        // A full projection turns orientations towards the integrals of the angular velocities.
        let kept = match coherence {
            Coherence::Full => vec![PHASE],
            _ => [QUATERNION.collect::<Vec<_>>(), vec![PHASE]].concat(),
        };
        for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let channel = index / time % CHANNELS;
            if kept.contains(&channel) {
                assert!(
                    (found - expected).abs() < 1e-4,
                    "{channel}: {found} {expected}"
                );
            }
        }
    }
}

#[test]
fn a_decoder_too_narrow_for_its_targets_is_refused() {
    let targets = ChannelEncoding {
        phase: PhaseEncoding::SinCos,
        orientation: OrientationEncoding::Rotation6d,
    };
    let normalization = Normalization {
        mean: vec![0.0; targets.channels()],
        std: vec![1.0; targets.channels()],
    };
    let config = DecoderConfig {
        hidden_dim: 25,
        ..Default::default()
    };
    let init = Initializer::new(3, &Device::flex());
    let error = config.init_for(targets, normalization, &init).unwrap_err();
    assert!(error.to_string().contains("decoder.hidden_dim"), "{error}");
}

#[test]
fn the_banded_projection_is_the_dense_one_with_its_gradient() {
    let device = Device::flex().autodiff();
    let decoder = decoder(Coherence::Full, &device);
    for time in [1, 2, 9, 40] {
        let run = |mode: Mode| {
            mode.scope(|| {
                let x = latent(5, [2, CHANNELS, time], &device).require_grad();
                let y = decoder.project(x.clone());
                let weights = latent(6, [2, CHANNELS, time], &device);
                let gradients = (y.clone() * weights).sum().backward();
                (
                    host_values(y),
                    host_values(x.grad(&gradients).expect("a gradient")),
                )
            })
        };
        let (banded, dense) = (run(Mode::Fused), run(Mode::Composed));
        for (index, (a, b)) in banded.0.iter().zip(&dense.0).enumerate() {
            // Rounded positions, differentiated.
            let allowed = match index / time % CHANNELS {
                c if VELOCITY.contains(&c) => 3e-4,
                c if ACCELERATION.contains(&c) => 1e-2,
                c if ANGULAR_VELOCITY.contains(&c) => 1e-4,
                _ => 5e-6,
            };
            assert!((a - b).abs() < allowed, "{index} of {time} frames: {a} {b}");
        }
        let largest = dense.1.iter().fold(1.0f32, |a, b| a.max(b.abs()));
        for (a, b) in banded.1.iter().zip(&dense.1) {
            assert!((a - b).abs() < 1e-4 * largest, "{time} frames: {a} {b}");
        }
    }
}

/// A turning dancer, with noise in orientations and angular velocities.
pub(super) fn shaken(seed: u64, frames: usize) -> Phrase {
    let noise = Key::new(seed, Purpose::Noise).normals(6 * frames);
    let mut motion = Phrase::new(vec![0.0; CHANNELS * frames]).unwrap();
    for (t, noise) in noise.chunks(6).enumerate() {
        let noise: Vec<f64> = noise.iter().map(|&value| f64::from(value)).collect();
        let turn = [0.1 * noise[0], 0.1 * noise[1], 0.1 * noise[2]];
        let at = Quaternion::from_yaw(2.0 * t as f64 / 30.0);
        let sign = if t % 7 == 3 { -1.0 } else { 1.0 };
        motion.set_quaternion(t, (Quaternion::from_rotation_vector(turn) * at).scale(sign));
        motion.set_vector(
            t,
            ANGULAR_VELOCITY,
            [0.1 * noise[3], 2.0 + 0.1 * noise[4], 0.1 * noise[5]],
        );
    }
    motion
}

pub(super) fn tensors(motions: &[Phrase], device: &Device) -> [Tensor<3>; 2] {
    let frames = motions[0].frames();
    let rows: Vec<f32> = motions.iter().flat_map(|m| m.as_slice().to_vec()).collect();
    let rows = TensorData::new(rows, [motions.len(), frames, CHANNELS]);
    let all = Tensor::<3>::from_data(rows, device).swap_dims(1, 2);
    [QUATERNION, ANGULAR_VELOCITY].map(|channels| all.clone().slice([0..motions.len(), channels]))
}

/// Asserts that the gradients of a loss of quaternions and angular velocities equal the loss's
/// central differences over `step`, up to an `allowed` error.
pub(super) fn assert_gradients(
    motions: &[Phrase],
    loss: impl Fn(Tensor<3>, Tensor<3>) -> Tensor<1>,
    step: f32,
    allowed: fn(f64) -> f64,
) {
    let device = Device::flex().autodiff();
    for mode in [Mode::Fused, Mode::Composed] {
        mode.scope(|| {
            let [quaternion, rates] = tensors(motions, &device).map(Tensor::require_grad);
            let gradients = loss(quaternion.clone(), rates.clone()).backward();
            for (which, of) in [&quaternion, &rates].into_iter().enumerate() {
                let gradient = of.grad(&gradients).expect("a gradient");
                let gradient: Vec<f32> = gradient.into_data().try_into_vec::<f32>().unwrap();
                let values: Vec<f32> = of.to_data().try_into_vec::<f32>().unwrap();
                for index in (0..values.len()).step_by(5) {
                    let at = |step: f32| -> f64 {
                        let mut values = values.clone();
                        values[index] += step;
                        let data = TensorData::new(values, of.dims());
                        let changed = Tensor::<3>::from_data(data, &device);
                        let both = match which {
                            0 => (changed, rates.clone()),
                            _ => (quaternion.clone(), changed),
                        };
                        f64::from(loss(both.0, both.1).into_scalar::<f32>())
                    };
                    let expected = (at(step) - at(-step)) / (2.0 * f64::from(step));
                    let found = f64::from(gradient[index]);
                    assert!(
                        (found - expected).abs() < allowed(expected),
                        "{which} {index}: {found} {expected}"
                    );
                }
                assert!(gradient.iter().any(|value| value.abs() > 1e-3));
            }
        });
    }
}
