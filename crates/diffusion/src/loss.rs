//! The training loss: a distance per element, averaged over all valid elements.
//!
//! ```text
//! d = model_output - target
//! mse    d^2
//! l1     |d|
//! huber  d^2 / 2 where |d| <= 1, else |d| - 1/2
//! ```
//!
//! Source: CC-MotionGen, sections 3.2.1 and 5.3 (docs/sources.md, section 1.4). The source does not
//! state the huber threshold.

use burn::tensor::Tensor;

use crate::LossType;
use crate::per_sample::per_sample;

/// The distance of each element.
///
/// # Shapes
/// - model_output, target, output: `[batch, channels, time]`
pub fn elementwise(model_output: Tensor<3>, target: Tensor<3>, loss_type: LossType) -> Tensor<3> {
    let difference = model_output - target;
    match loss_type {
        LossType::Mse => difference.clone() * difference,
        LossType::L1 => difference.abs(),
        LossType::Huber => {
            // Both branches at once: c^2 / 2 + (|d| - c) with c = min(|d|, 1).
            let distance = difference.abs();
            let capped = distance.clone().clamp_max(1.0);
            capped.clone() * capped.clone() * 0.5 + (distance - capped)
        }
    }
}

/// The mean distance over the valid elements: `sum(weight mask distance) / (channels sum(mask))`.
///
/// Without a mask all elements are valid. As in min-SNR weighting, the weights scale the sum but
/// not the count. A batch without valid elements has loss 0.
///
/// The sums run over time, then channels, then the batch. On Burn's CPU backend a plain sum of
/// 4,194,304 or more elements depends on thread scheduling, so a resumed run would not repeat the
/// sum.
///
/// # Shapes
/// - model_output, target: `[batch, channels, time]`
/// - mask: `[batch, time]`, 1 for valid frames, 0 for padding
/// - weights: one per sample
/// - output: `[1]`
///
/// # Panics
/// Panics unless there is one weight per sample and the sizes of the tensors agree.
pub fn diffusion_loss(
    model_output: Tensor<3>,
    target: Tensor<3>,
    mask: Option<Tensor<2>>,
    weights: Option<&[f64]>,
    loss_type: LossType,
) -> Tensor<1> {
    let [batch, channels, time] = model_output.dims();
    let mut distance = elementwise(model_output, target, loss_type);
    if let Some(mask) = &mask {
        distance = distance * mask.clone().reshape([batch, 1, time]);
    }
    let mut of_sample = distance.sum_dim(2).sum_dim(1);
    if let Some(weights) = weights {
        let weights = per_sample(weights, &of_sample);
        of_sample = of_sample * weights;
    }
    let sum = of_sample.sum_dim(0).reshape([1]);
    match mask {
        Some(mask) => {
            let frames = mask.sum_dim(1).sum_dim(0).reshape([1]);
            sum / (frames * channels as f64).clamp_min(1.0)
        }
        None => sum / (batch * channels * time).max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};
    use proptest::prelude::*;

    use super::*;

    const TYPES: [LossType; 3] = [LossType::Mse, LossType::L1, LossType::Huber];

    fn normal(seed: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
        let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    /// 1 for the first `lengths[b]` of `time` frames.
    fn mask_of(lengths: &[usize], time: usize) -> Tensor<2> {
        let values: Vec<f32> = lengths
            .iter()
            .flat_map(|&length| (0..time).map(move |t| if t < length { 1.0 } else { 0.0 }))
            .collect();
        Tensor::from_data(
            TensorData::new(values, [lengths.len(), time]),
            &Device::flex(),
        )
    }

    fn value(loss: Tensor<1>) -> f64 {
        f64::from(loss.into_scalar::<f32>())
    }

    #[test]
    fn distances_have_their_values_and_slopes() {
        let device = Device::flex().autodiff();
        let differences = [-3.0f32, -1.0, -0.5, 0.0, 0.25, 1.0, 2.0];
        let expected: [(LossType, [f32; 7], [f32; 7]); 3] = [
            (
                LossType::Mse,
                [9.0, 1.0, 0.25, 0.0, 0.0625, 1.0, 4.0],
                [-6.0, -2.0, -1.0, 0.0, 0.5, 2.0, 4.0],
            ),
            (
                LossType::L1,
                [3.0, 1.0, 0.5, 0.0, 0.25, 1.0, 2.0],
                [-1.0, -1.0, -1.0, 0.0, 1.0, 1.0, 1.0],
            ),
            (
                LossType::Huber,
                [2.5, 0.5, 0.125, 0.0, 0.03125, 0.5, 1.5],
                [-1.0, -1.0, -0.5, 0.0, 0.25, 1.0, 1.0],
            ),
        ];
        for (loss_type, values, slopes) in expected {
            let data = TensorData::new(differences.to_vec(), [1, 1, 7]);
            let x = Tensor::<3>::from_data(data, &device).require_grad();
            let distance = elementwise(x.clone(), x.zeros_like(), loss_type);
            assert_eq!(
                distance.to_data().try_to_vec::<f32>().unwrap(),
                values,
                "{loss_type:?}"
            );
            let gradients = distance.sum().backward();
            let slope = x
                .grad(&gradients)
                .unwrap()
                .into_data()
                .try_to_vec::<f32>()
                .unwrap();
            assert_eq!(slope, slopes, "{loss_type:?}");
        }
    }

    #[test]
    fn without_mask_and_weights_it_is_the_mean() {
        let device = Device::flex();
        let (x, y) = (normal(1, [3, 5, 7], &device), normal(2, [3, 5, 7], &device));
        for loss_type in TYPES {
            let expected = value(elementwise(x.clone(), y.clone(), loss_type).mean());
            let found = value(diffusion_loss(x.clone(), y.clone(), None, None, loss_type));
            assert!(
                (found / expected - 1.0).abs() < 1e-6,
                "{loss_type:?}: {found} {expected}"
            );
        }
    }

    #[test]
    fn padding_gets_no_gradient() {
        let device = Device::flex().autodiff();
        let x = normal(1, [2, 3, 6], &device).require_grad();
        let mask = Tensor::from_inner(mask_of(&[6, 4], 6));
        let loss = diffusion_loss(x.clone(), x.zeros_like(), Some(mask), None, LossType::L1);
        let gradients = loss.backward();
        let gradient = x
            .grad(&gradients)
            .unwrap()
            .into_data()
            .try_to_vec::<f32>()
            .unwrap();
        for (index, slope) in gradient.iter().enumerate() {
            let padding = index / 18 == 1 && index % 6 >= 4;
            assert_eq!(
                slope.abs(),
                if padding { 0.0 } else { 1.0 / 30.0 },
                "element {index}"
            );
        }
    }

    #[test]
    fn nothing_valid_is_a_loss_of_zero() {
        let x = normal(1, [2, 3, 6], &Device::flex());
        let mask = mask_of(&[0, 0], 6);
        let loss = diffusion_loss(x.clone(), x.zeros_like(), Some(mask), None, LossType::Mse);
        assert_eq!(value(loss), 0.0);
    }

    /// Flex's own `sum` is not repeatable above 4,194,304 elements.
    #[test]
    fn a_large_loss_is_repeated_bit_for_bit() {
        let device = Device::flex();
        let shape = [4, 32, 33_000];
        let (x, y) = (normal(1, shape, &device), normal(2, shape, &device));
        let loss = || diffusion_loss(x.clone(), y.clone(), None, None, LossType::Mse);
        let bits: Vec<u32> = (0..5)
            .map(|_| loss().into_scalar::<f32>().to_bits())
            .collect();
        assert!(bits.iter().all(|&b| b == bits[0]), "{bits:?}");
        assert!((f64::from(f32::from_bits(bits[0])) - 2.0).abs() < 0.01);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn padding_at_the_end_changes_nothing(
            seed: u64,
            length in 1usize..12,
            padding in 1usize..6,
            loss_type in prop::sample::select(TYPES.to_vec()),
        ) {
            let device = Device::flex();
            let shape = [2, 3, length + padding];
            let (x, y) = (normal(seed, shape, &device), normal(seed ^ 1, shape, &device));
            let mask = mask_of(&[length, length], length + padding);
            let padded = value(diffusion_loss(x.clone(), y.clone(), Some(mask), None, loss_type));
            let short = |x: Tensor<3>| x.narrow(2, 0, length);
            let expected = value(diffusion_loss(short(x), short(y), None, None, loss_type));
            prop_assert!((padded / expected - 1.0).abs() < 2e-6, "{padded} {expected}");
        }

        /// A sample's share of the loss depends on its valid frames and its weight.
        #[test]
        fn masks_and_weights_add_up_over_the_samples(
            seed: u64,
            lengths in prop::collection::vec(1usize..9, 3),
            weights in prop::collection::vec(0.0f64..4.0, 3),
        ) {
            let device = Device::flex();
            let (x, y) = (normal(seed, [3, 2, 9], &device), normal(seed ^ 1, [3, 2, 9], &device));
            let mask = mask_of(&lengths, 9);
            let whole =
                diffusion_loss(x.clone(), y.clone(), Some(mask), Some(&weights), LossType::Mse);
            let frames: usize = lengths.iter().sum();
            let mut expected = 0.0;
            for (b, (&length, weight)) in lengths.iter().zip(&weights).enumerate() {
                let part = |x: &Tensor<3>| x.clone().narrow(0, b, 1).narrow(2, 0, length);
                let alone = diffusion_loss(part(&x), part(&y), None, None, LossType::Mse);
                expected += weight * value(alone) * length as f64 / frames as f64;
            }
            let whole = value(whole);
            prop_assert!((whole - expected).abs() <= 1e-6 * (1.0 + expected), "{whole} {expected}");
        }
    }
}
