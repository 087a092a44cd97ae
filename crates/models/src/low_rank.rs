//! The low-rank change of one layer's weight (Hu et al. 2021, <https://arxiv.org/abs/2106.09685>).
//!
//! Burn's `LoraAdapter` supports only two-dimensional weights, not convolutions. Its factors are
//! children of the weight in the module tree, not siblings.

use burn::module::{Module, Param};
use burn::tensor::Tensor;

use crate::{Initializer, LoraConfig};

/// A change of a frozen weight `W` by a product of two thin matrices:
///
/// ```text
/// W' = W + (alpha / rank) reshape(b a)
/// ```
///
/// `a` is `[rank, fan_in]` and `b` `[out, rank]`; `fan_in` is `in` for a linear layer and `in *
/// kernel` for a convolution. As in PEFT, `a` starts uniform in `+-1 / sqrt(fan_in)` and `b` at
/// zero, so that the initial change is zero.
#[derive(Module, Debug)]
pub struct LowRank {
    a: Param<Tensor<2>>,
    b: Param<Tensor<2>>,
    scale: f64,
}

impl LowRank {
    /// The initial change of a weight `[outputs, ..]` with `fan_in` elements per row.
    pub fn new(fan_in: usize, outputs: usize, config: &LoraConfig, init: &Initializer) -> Self {
        Self {
            a: init.uniform("a", [config.rank, fan_in], fan_in),
            b: init.constant([outputs, config.rank], 0.0),
            scale: config.alpha / config.rank as f64,
        }
    }

    /// # Shapes
    /// - weight, output: `[out, ..]`
    pub fn apply<const D: usize>(&self, weight: Tensor<D>) -> Tensor<D> {
        let shape = weight.dims();
        let change = self.b.val().mul_scalar(self.scale).matmul(self.a.val());
        weight + change.reshape(shape)
    }

    /// The sum of the weight and the change, as a frozen parameter.
    pub fn merge<const D: usize>(self, weight: Param<Tensor<D>>) -> Param<Tensor<D>> {
        // Without gradients no graph outlives the sum.
        let change = self.no_grad();
        weight
            .set_require_grad(false)
            .map(|weight| change.apply(weight))
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::layers::{Conv1d, Linear};
    use crate::lora::Adaptable;
    use crate::parameters;

    const CONFIG: LoraConfig = LoraConfig {
        rank: 2,
        alpha: 3.0,
        targets: Vec::new(),
    };

    fn init() -> Initializer {
        Initializer::new(4, &Device::flex().autodiff())
    }

    /// The layer with an adapter whose `b` is nonzero.
    fn disturbed<M: Module>(layer: M) -> M {
        parameters::update(layer, |index, values| {
            for (i, value) in values.iter_mut().enumerate() {
                *value += 0.3 * ((7 * index + 5 * i) as f32).sin();
            }
        })
    }

    fn ramp<const D: usize>(shape: [usize; D]) -> Tensor<D> {
        let n = shape.iter().product::<usize>();
        let values: Vec<f32> = (0..n).map(|i| (0.7 * i as f32).cos()).collect();
        Tensor::from_data(TensorData::new(values, shape), &Device::flex().autodiff())
    }

    /// Compares the gradients of a frozen layer with an adapter to central differences. The loss is
    /// quadratic in each element, so differences over any distance are exact.
    fn check_gradients<M: Module>(layer: M, loss: impl Fn(&M) -> Tensor<1>) {
        let mut tracked = loss(&layer).backward();
        let gradients = crate::gradients(&layer, &mut tracked);
        let weights = parameters::export(&layer);
        let names: Vec<&str> = weights.iter().map(|p| p.info.name.as_str()).collect();
        assert_eq!(names, ["weight", "bias", "lora.a", "lora.b"]);
        for frozen in &gradients[..2] {
            assert!(frozen.iter().all(|&g| g == 0.0), "{frozen:?}");
        }

        let values: Vec<Vec<f32>> = weights.iter().map(|p| p.values.clone()).collect();
        let loss_with = |parameter: usize, element: usize, step: f32| {
            let mut values = values.clone();
            values[parameter][element] += step;
            let moved = parameters::replace(layer.clone(), values);
            f64::from(loss(&moved).into_scalar::<f32>())
        };
        for parameter in 2..4 {
            for (element, &gradient) in gradients[parameter].iter().enumerate() {
                let step = 0.5;
                let difference =
                    loss_with(parameter, element, step) - loss_with(parameter, element, -step);
                let expected = difference / f64::from(2.0 * step);
                let error = (f64::from(gradient) - expected).abs();
                let name = names[parameter];
                assert!(expected.abs() > 1e-3, "{name}[{element}] does not matter");
                assert!(
                    error < 1e-4 * expected.abs().max(1.0),
                    "{name}[{element}]: {gradient}, by differences {expected}"
                );
            }
        }
    }

    #[test]
    fn gradients_reach_the_factors_of_a_strided_convolution_alone() {
        let layer = Conv1d::strided(3, 4, 3, 2, &init()).no_grad();
        let layer = disturbed(layer.with_adapter(&CONFIG, &init().at("lora")));
        let x = ramp([2, 3, 7]);
        check_gradients(layer, |layer| layer.forward(x.clone()).square().sum());
    }

    #[test]
    fn gradients_reach_the_factors_of_a_linear_layer_alone() {
        let layer = Linear::new(3, 4, &init()).no_grad();
        let layer = disturbed(layer.with_adapter(&CONFIG, &init().at("lora")));
        let (rows, frames) = (ramp([5, 3]), ramp([2, 3, 4]));
        check_gradients(layer.clone(), |layer| {
            layer.forward(rows.clone()).square().sum()
        });
        check_gradients(layer, |layer| {
            layer.forward_frames(frames.clone()).square().sum()
        });
    }

    #[test]
    fn the_change_is_the_scaled_product_in_the_weights_own_order() {
        let layer = Conv1d::strided(2, 3, 3, 1, &init()).no_grad();
        let layer = disturbed(layer.with_adapter(&CONFIG, &init().at("lora")));
        let before = parameters::export(&layer);
        let [weight, _, a, b] = &before[..] else {
            panic!("four parameters");
        };
        assert_eq!(a.info.shape, [2, 6]);
        assert_eq!(b.info.shape, [3, 2]);
        let merged = parameters::export(&layer.merge_adapter());
        assert_eq!(merged[0].info, weight.info);
        for (i, (merged, weight)) in merged[0].values.iter().zip(&weight.values).enumerate() {
            let (row, column) = (i / 6, i % 6);
            let product: f32 = (0..2)
                .map(|r| b.values[2 * row + r] * a.values[6 * r + column])
                .sum();
            let expected = weight + 1.5 * product;
            assert!((merged - expected).abs() < 1e-6, "{merged} {expected}");
            assert!(product.abs() > 1e-4, "a change of zero proves nothing");
        }
    }
}
