//! Matrix products in full float32 precision.

use burn::tensor::{Tensor, s};

use crate::mode::fuses;

/// Channels per block; the products of a block take `BLOCK` times the memory of the result.
const BLOCK: usize = 16;

/// `W x` of every frame, with float32 products on every device.
///
/// GPU matrix units may use 10 of the 23 mantissa bits (TF32). Each factor then has a relative
/// error of up to 1/2,000, which a matrix with a large inverse amplifies to the size of the values.
/// Devices other than the CPU therefore multiply element by element, [`BLOCK`] channels at a time.
///
/// # Shapes
/// - matrix: `[channels_out, channels]`
/// - x: `[batch, channels, time]`
/// - output: `[batch, channels_out, time]`
pub fn float32_product(matrix: Tensor<2>, x: Tensor<3>) -> Tensor<3> {
    if fuses(&x) {
        return matrix.unsqueeze::<3>().matmul(x);
    }
    let [channels_out, channels] = matrix.dims();
    let [batch, _, time] = x.dims();
    let blocks = (0..channels).step_by(BLOCK).map(|first| {
        let block = first..channels.min(first + BLOCK);
        let size = block.len();
        let matrix = matrix.clone().slice(s![.., block.clone()]);
        let x = x.clone().slice(s![.., block, ..]);
        let products =
            matrix.reshape([1, channels_out, size, 1]) * x.reshape([batch, 1, size, time]);
        products.sum_dim(2).reshape([batch, channels_out, time])
    });
    let sum = blocks.reduce(|sum, block| sum + block);
    sum.expect("a matrix has channels")
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};

    use super::*;
    use crate::Mode;

    /// The mantissa rounded to TF32's 10 bits.
    fn tf32(value: f32) -> f32 {
        f32::from_bits((value.to_bits() + 0x1000) & !0x1fff)
    }

    #[test]
    fn products_have_the_digits_that_tf32_loses() {
        let (batch, rows, columns, time) = (2, 29, 37, 5);
        let values = |at, count| Key::new(3, Purpose::Synthetic).at(at).normals(count);
        let (matrix, x) = (values(0, rows * columns), values(1, batch * columns * time));
        let product = |round: fn(f32) -> f32| -> Vec<f64> {
            let mut out = Vec::with_capacity(batch * rows * time);
            for sample in x.chunks(columns * time) {
                for row in matrix.chunks(columns) {
                    out.extend((0..time).map(|t| {
                        let products = row.iter().enumerate().map(|(column, &weight)| {
                            f64::from(round(weight)) * f64::from(round(sample[column * time + t]))
                        });
                        products.sum::<f64>()
                    }));
                }
            }
            out
        };
        let exact = product(|value| value);
        let largest = |found: Vec<f64>| {
            let pairs = found.iter().zip(&exact);
            pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
        };
        let rounded = largest(product(tf32));
        let device = Device::flex();
        let tensor =
            |values: &[f32], shape: &[usize]| TensorData::new(values.to_vec(), shape.to_vec());
        for mode in [Mode::Fused, Mode::Composed] {
            let found = mode.scope(|| {
                float32_product(
                    Tensor::from_data(tensor(&matrix, &[rows, columns]), &device),
                    Tensor::from_data(tensor(&x, &[batch, columns, time]), &device),
                )
            });
            assert_eq!(found.dims(), [batch, rows, time]);
            let found = found.try_into_vec_as::<f32>().unwrap();
            let error = largest(found.into_iter().map(f64::from).collect());
            assert!(error < 1e-5, "{mode:?}: {error}");
            assert!(
                rounded > 100.0 * error,
                "{mode:?}: {error} beside {rounded}"
            );
        }
    }
}
