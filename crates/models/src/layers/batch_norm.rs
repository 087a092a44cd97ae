use burn::module::{Module, Param, RunningState};
use burn::tensor::Tensor;

use crate::Initializer;

/// Added to the variance.
pub const BATCH_NORM_EPS: f64 = 1e-5;

/// The share of a batch in the running statistics.
const MOMENTUM: f64 = 0.1;

/// Normalizes each feature over the rows, then scales and shifts it: weight and bias `[features]`.
///
/// In training the rows' own mean and biased variance normalize them, and the running statistics
/// follow these means and the unbiased variances. Otherwise the running statistics normalize the
/// rows. The running statistics are frozen parameters, `running_mean` and `running_var`.
#[derive(Module, Debug)]
pub struct BatchNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    running_mean: RunningState<Tensor<1>>,
    running_var: RunningState<Tensor<1>>,
}

impl BatchNorm {
    /// A normalization of `features`, with running statistics of mean 0 and variance 1.
    pub fn new(features: usize, init: &Initializer) -> Self {
        Self {
            weight: init.constant([features], 1.0),
            bias: init.constant([features], 0.0),
            running_mean: init.running([features], 0.0),
            running_var: init.running([features], 1.0),
        }
    }

    /// A single row in training has no variance and leaves the running variance unchanged.
    ///
    /// # Shapes
    /// - x, output: `[rows, features]`
    pub fn forward(&self, x: Tensor<2>, training: bool) -> Tensor<2> {
        let rows = x.dims()[0];
        let (mean, variance) = match training {
            true => {
                let mean = x.clone().mean_dim(0);
                let variance = (x.clone() - mean.clone()).square().mean_dim(0);
                follow(&self.running_mean, mean.clone());
                if rows > 1 {
                    let unbiased = variance.clone() * (rows as f64 / (rows - 1) as f64);
                    follow(&self.running_var, unbiased);
                }
                (mean, variance)
            }
            false => (
                self.running_mean.value().unsqueeze_dim(0),
                self.running_var.value().unsqueeze_dim(0),
            ),
        };
        let normalized = (x - mean) / (variance + BATCH_NORM_EPS).sqrt();
        normalized * self.weight.val().unsqueeze_dim(0) + self.bias.val().unsqueeze_dim(0)
    }
}

/// Moves a running statistic towards that of a batch, `[1, features]`.
fn follow(running: &RunningState<Tensor<1>>, batch: Tensor<2>) {
    let batch = batch.squeeze_dim::<1>(0).detach();
    let value = running.value() * (1.0 - MOMENTUM) + batch * MOMENTUM;
    running.update(value.detach());
    // The value takes effect at once.
    running.value_sync();
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::parameters;

    fn layer(device: &Device) -> BatchNorm {
        BatchNorm::new(2, &Initializer::new(1, device))
    }

    fn rows(values: &[f32], device: &Device) -> Tensor<2> {
        let data = TensorData::new(values.to_vec(), [values.len() / 2, 2]);
        Tensor::from_data(data, device)
    }

    fn values(x: Tensor<2>) -> Vec<f32> {
        x.into_data().try_to_vec().unwrap()
    }

    fn near(found: &[f32], expected: &[f32]) {
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() < 1e-4, "{found:?}, expected {expected:?}");
        }
    }

    #[test]
    fn training_uses_the_batch_and_evaluation_the_running_statistics() {
        let device = Device::flex();
        let norm = layer(&device);
        let x = rows(&[1.0, 4.0, 3.0, 4.0], &device);
        // Feature 0: mean 2, biased variance 1; feature 1 is constant.
        near(
            &values(norm.forward(x.clone(), true)),
            &[-1.0, 0.0, 1.0, 0.0],
        );
        let of_name = |norm: &BatchNorm, name: &str| {
            let all = parameters::export(norm);
            let found = all.into_iter().find(|each| each.info.name == name);
            found.expect("a parameter").values
        };
        near(&of_name(&norm, "running_mean"), &[0.2, 0.4]);
        // The unbiased variance of feature 0 is 2.
        near(&of_name(&norm, "running_var"), &[1.1, 0.9]);
        let expected = [
            (1.0 - 0.2) / 1.1f32.sqrt(),
            (4.0 - 0.4) / 0.9f32.sqrt(),
            (3.0 - 0.2) / 1.1f32.sqrt(),
            (4.0 - 0.4) / 0.9f32.sqrt(),
        ];
        near(&values(norm.forward(x.clone(), false)), &expected);
        // Evaluation changes nothing.
        near(&of_name(&norm, "running_mean"), &[0.2, 0.4]);
    }

    #[test]
    fn running_statistics_are_saved_and_not_trained() {
        let device = Device::flex().autodiff();
        let norm = layer(&device);
        assert_eq!(parameters::trainable(&norm), [true, true, false, false]);
        norm.forward(rows(&[1.0, 4.0, 3.0, 4.0], &device), true);
        assert_eq!(parameters::trainable(&norm), [true, true, false, false]);
        let saved = parameters::export(&norm);
        let names: Vec<&str> = saved.iter().map(|each| each.info.name.as_str()).collect();
        assert_eq!(names, ["weight", "bias", "running_mean", "running_var"]);
        let loaded = parameters::load(layer(&device), saved.clone()).unwrap();
        assert_eq!(parameters::export(&loaded), saved);
        assert_eq!(parameters::export(&loaded.valid()), saved);
    }

    #[test]
    fn the_gradient_is_that_of_the_batch_s_own_statistics() {
        let device = Device::flex().autodiff();
        let norm = layer(&device);
        let x = rows(&[1.0, 4.0, 3.0, 5.0, -2.0, 6.0], &device).require_grad();
        let y = norm.forward(x.clone(), true);
        let gradients = y.sum().backward();
        // The sum of normalized rows does not depend on the rows.
        let gradient = values(x.grad(&gradients).expect("a gradient"));
        assert!(
            gradient.iter().all(|value| value.abs() < 1e-5),
            "{gradient:?}"
        );
    }
}
