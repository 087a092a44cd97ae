//! Samples of a batch against the same samples alone, bit for bit.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::{Convolution, Mode, batch_invariant, linear};

fn random(shape: [usize; 3], stream: u64) -> Tensor<3> {
    let values = Key::new(stream, Purpose::Sampling).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn bits(x: Tensor<3>) -> Vec<u32> {
    let values = x.try_into_vec_as::<f32>().expect("float32");
    values.into_iter().map(f32::to_bits).collect()
}

/// True if `operation` gives each sample the bits that it gets alone, in the scope and outside.
fn is_invariant(shape: [usize; 3], operation: impl Fn(Tensor<3>) -> Tensor<3>) -> [bool; 2] {
    let x = random(shape, 1);
    let alone: Vec<u32> = (0..shape[0])
        .flat_map(|sample| bits(operation(x.clone().narrow(0, sample, 1))))
        .collect();
    let within = batch_invariant(shape[0], || bits(operation(x.clone())));
    [within == alone, bits(operation(x)) == alone]
}

#[test]
fn a_sample_gets_the_same_bits_in_a_batch() {
    Mode::Fused.scope(|| {
        let weight = random([48, 40, 3], 2);
        // 12 rows of a sample are few rows; 60 rows of the batch are many.
        let convolve = |x| Convolution::new(weight.clone(), 1).forward(x);
        assert_eq!(is_invariant([5, 40, 12], convolve), [true, false]);
        let weight = random([96, 40, 1], 3).reshape([96, 40]);
        let project = |x: Tensor<3>| {
            let [batch, channels, _] = x.dims();
            let rows = x.reshape([batch, channels]);
            let bias = Tensor::zeros([96], &rows.device());
            linear(rows, weight.clone(), bias).reshape([batch, 96, 1])
        };
        assert!(is_invariant([40, 40, 1], project)[0]);
    });
}
