//! Cached packed weights give the same bits and are never used for another weight.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::{Convolution, Mode, cache_packed_weights};

fn random(shape: [usize; 3], stream: u64) -> Tensor<3> {
    let values = Key::new(stream, Purpose::Sampling).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn convolved(x: &Tensor<3>, weight: &Tensor<3>) -> Vec<u32> {
    let y = Convolution::new(weight.clone(), 1).forward(x.clone());
    let values = y.try_into_vec_as::<f32>().expect("float32");
    values.into_iter().map(f32::to_bits).collect()
}

#[test]
fn a_cached_weight_gives_the_same_bits() {
    Mode::Fused.scope(|| {
        // One and three taps, with fewer and more columns than a panel.
        for (kernel, channels) in [(1, 48), (1, 150), (3, 150)] {
            let weight = random([channels, 40, kernel], 2);
            let inputs: Vec<_> = (0..3).map(|i| random([1, 40, 23 + 20 * i], 3)).collect();
            let all = || -> Vec<_> { inputs.iter().map(|x| convolved(x, &weight)).collect() };
            let plain = all();
            let cached = cache_packed_weights(|| [all(), all()]);
            assert_eq!(cached, [plain.clone(), plain]);
        }
    });
}

#[test]
fn a_weight_that_changes_is_another() {
    Mode::Fused.scope(|| {
        let x = random([2, 40, 11], 1);
        cache_packed_weights(|| {
            let mut weight = random([96, 40, 1], 2);
            for _ in 0..4 {
                let found = convolved(&x, &weight);
                assert_eq!(found, outside(&x, &weight));
                // The weight changes in place, unless the cache shares it.
                weight = weight.mul_scalar(1.5);
            }
            // The first channels of a weight have its address.
            let some = weight.clone().narrow(0, 0, 64);
            assert_eq!(convolved(&x, &some), outside(&x, &some));
            assert_eq!(convolved(&x, &weight), outside(&x, &weight));
        });
    });
}

/// Convolved on another thread, which has no cache.
fn outside(x: &Tensor<3>, weight: &Tensor<3>) -> Vec<u32> {
    std::thread::scope(|scope| {
        let work = || Mode::Fused.scope(|| convolved(x, weight));
        scope.spawn(work).join().expect("a convolution")
    })
}
