//! Activation checkpointing over several operations: equal bits.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::{
    Activation, Convolution, GroupNorm, Mode, concat_channels, cross_attention, gelu, host_values,
    layer_norm, self_attention, stored,
};

const BATCH: usize = 2;
const CHANNELS: usize = 8;
const TIME: usize = 6;

fn values(number: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = Key::new(number, Purpose::Dropout).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Gradients of a network of all operations whose outputs may be computed again.
fn gradients(device: &Device) -> Vec<Vec<f32>> {
    let leaf = |number: u64, shape: [usize; 3]| values(number, shape, device).require_grad();
    let x = leaf(1, [BATCH, CHANNELS, TIME]);
    let weights: Vec<Tensor<3>> = (0..8)
        .map(|number| {
            leaf(
                10 + number,
                [CHANNELS, CHANNELS, 1 + 2 * (number as usize % 2)],
            )
        })
        .collect();
    let wide = leaf(30, [3 * CHANNELS, 2 * CHANNELS, 1]);
    let double = leaf(31, [2 * CHANNELS, CHANNELS, 1]);
    let (scale, shift) = (leaf(32, [1, 1, CHANNELS]), leaf(33, [1, 1, CHANNELS]));
    let norm = || {
        let flat = |tensor: &Tensor<3>| tensor.clone().reshape([CHANNELS]);
        GroupNorm::new(flat(&scale), flat(&shift), 4, 1e-5).activation(Activation::Silu)
    };
    let conv = |number: usize| Convolution::new(weights[number].clone(), 1);

    let mut h = x.clone();
    for block in 0..2 {
        let inner = conv(2 * block).norm(norm()).recomputed().forward(h.clone());
        h = conv(2 * block + 1).norm(norm()).residual(h).forward(inner);
    }
    let skip = h.clone();
    let h = norm().forward(conv(4).recomputed().forward(h));
    let h = stored(h + skip.clone());
    let all = concat_channels(h.clone(), skip);
    let attended = self_attention(Convolution::new(wide, 1).recomputed().forward(all), 2, None);
    let queries = conv(5).recomputed().forward(attended.clone());
    let keys_values = Convolution::new(double, 1).recomputed().forward(h);
    let h = cross_attention(queries, keys_values, 2, None) + attended;
    let rows = h.swap_dims(1, 2).reshape([BATCH * TIME, CHANNELS]);
    let flat = |tensor: &Tensor<3>| tensor.clone().reshape([CHANNELS]);
    let rows = layer_norm(rows, flat(&scale), flat(&shift), 1e-5);
    let h = rows.reshape([BATCH, TIME, CHANNELS]).swap_dims(1, 2);
    let h = gelu(conv(6).recomputed().forward(h));
    let y = conv(7).forward(h);
    let loss = (y * values(99, [BATCH, CHANNELS, TIME], device)).sum();
    let mut all = loss.backward();
    let leaves = weights.iter().chain([&x, &scale, &shift]);
    leaves
        .map(|leaf| host_values(leaf.grad_remove(&mut all).expect("a gradient")))
        .collect()
}

#[test]
fn gradients_have_equal_bits_with_activation_checkpointing() {
    Mode::Fused.scope(|| {
        let device = Device::flex().autodiff();
        let kept = gradients(&device);
        assert!(kept.iter().flatten().any(|value| *value != 0.0));
        assert!(kept == gradients(&device.gradient_checkpointing()));
    });
}
