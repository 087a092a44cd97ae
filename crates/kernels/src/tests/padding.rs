//! Samples of a padded batch against each sample alone.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::{Activation, Convolution, GroupNorm, Lengths, Mode, cross_attention, self_attention};

const CHANNELS: usize = 12;
const TIME: usize = 21;
const LENGTHS: [usize; 3] = [13, 21, 1];

fn random(shape: [usize; 3], stream: u64) -> Tensor<3> {
    let values = Key::new(stream, Purpose::Noise).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn vector(stream: u64) -> Tensor<1> {
    random([1, 1, CHANNELS], stream).reshape([CHANNELS])
}

/// Asserts that each sample has the same valid frames as alone; `frames` maps input frames to
/// output frames.
fn agrees(
    channels: usize,
    frames: fn(usize) -> usize,
    operation: impl Fn(Tensor<3>, Option<Lengths>) -> Tensor<3>,
) {
    for mode in [Mode::Fused, Mode::Composed] {
        mode.scope(|| {
            let padded = random([LENGTHS.len(), channels, TIME], 7).mul_scalar(3.0);
            let together = operation(padded.clone(), Some(Lengths::new(LENGTHS)));
            for (sample, length) in LENGTHS.into_iter().enumerate() {
                let alone = padded.clone().narrow(0, sample, 1).narrow(2, 0, length);
                let alone = operation(alone, None);
                assert_eq!(alone.dims()[2], frames(length));
                let found = together.clone().narrow(0, sample, 1);
                let found = found.narrow(2, 0, frames(length));
                let apart = (found - alone).abs().max().into_scalar::<f32>();
                assert!(apart < 1e-5, "{mode:?}, sample {sample}: {apart}");
            }
        });
    }
}

#[test]
fn a_normalisation_measures_valid_frames() {
    let norm = || GroupNorm::new(vector(1), vector(2), 4, 1e-5).activation(Activation::Silu);
    agrees(
        CHANNELS,
        |n| n,
        |x, lengths| norm().lengths(lengths).forward(x),
    );
    let weight = random([5, CHANNELS, 3], 3);
    let convolve = |x: Tensor<3>, lengths| {
        let norm = norm().lengths(lengths);
        Convolution::new(weight.clone(), 2).norm(norm).forward(x)
    };
    agrees(CHANNELS, |n| n.div_ceil(2), convolve);
}

#[test]
fn a_convolution_sees_zeros_in_padding() {
    let weight = random([5, CHANNELS, 3], 3);
    for stride in [1, 2] {
        let frames = [|n: usize| n, |n: usize| n.div_ceil(2)][stride - 1];
        agrees(CHANNELS, frames, |x, lengths| {
            Convolution::new(weight.clone(), stride)
                .lengths(lengths)
                .forward(x)
        });
    }
    // Twice the frames of each sample, less one.
    agrees(
        CHANNELS,
        |n| 2 * n - 1,
        |x, lengths| {
            let frames = 2 * x.dims()[2] - 1;
            let odd = lengths.map(|l| Lengths::new(l.frames().iter().map(|n| 2 * n - 1)));
            Convolution::new(weight.clone(), 1)
                .upsample(frames)
                .lengths(odd)
                .forward(x)
        },
    );
}

#[test]
fn attention_gives_padding_no_weight() {
    agrees(
        3 * CHANNELS,
        |n| n,
        |x, lengths| self_attention(x, 3, lengths.as_ref()),
    );
    agrees(
        3 * CHANNELS,
        |n| n,
        |x, lengths| {
            let queries = x.clone().narrow(1, 0, CHANNELS);
            let keys_values = x.narrow(1, CHANNELS, 2 * CHANNELS);
            cross_attention(queries, keys_values, 3, lengths.as_ref())
        },
    );
}

#[test]
fn padding_has_no_gradient() {
    for mode in [Mode::Fused, Mode::Composed] {
        mode.scope(|| {
            let device = Device::flex().autodiff();
            let values = random([3, CHANNELS, TIME], 7).into_data();
            let x = Tensor::<3>::from_data(values, &device).require_grad();
            let on = |tensor: Tensor<1>| Tensor::<1>::from_data(tensor.into_data(), &device);
            let norm = GroupNorm::new(on(vector(1)), on(vector(2)), 4, 1e-5)
                .lengths(Some(Lengths::new(LENGTHS)));
            // The loss includes the padding.
            let loss = norm.forward(x.clone()).powi_scalar(3).sum();
            let gradient = x.grad(&loss.backward()).expect("a leaf");
            for (sample, length) in LENGTHS.into_iter().enumerate() {
                let of_sample = gradient.clone().narrow(0, sample, 1).abs();
                if length < TIME {
                    let padding = of_sample.clone().narrow(2, length, TIME - length);
                    assert_eq!(padding.max().into_scalar::<f32>(), 0.0, "{mode:?}");
                }
                if length > 1 {
                    let real = of_sample.narrow(2, 0, length).max().into_scalar::<f32>();
                    assert!(real > 1e-3, "{mode:?}");
                }
            }
        });
    }
}
