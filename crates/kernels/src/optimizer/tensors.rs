//! The optimizer's step in Burn's operations, for parameters on other devices.

use burn::tensor::Tensor;

use super::AdamW;

/// State of one parameter on its device; all rows have the same length.
#[derive(Clone, Debug)]
pub struct AdamWTensors {
    /// The values.
    pub parameter: Tensor<1>,
    /// Running mean of the gradient.
    pub exp_avg: Tensor<1>,
    /// Running mean of the squared gradient.
    pub exp_avg_sq: Tensor<1>,
    /// The moving average of the values, and its rate.
    pub ema: Option<(Tensor<1>, f64)>,
}

impl AdamW {
    /// The step of [`update`](Self::update) on the tensors' device.
    #[must_use]
    pub fn update_tensors(&self, state: AdamWTensors, gradient: Tensor<1>) -> AdamWTensors {
        let numbers = self.coefficients();
        let gradient = gradient.mul_scalar(numbers.scale);
        let exp_avg =
            state.exp_avg.mul_scalar(numbers.beta1) + gradient.clone().mul_scalar(numbers.share1);
        let exp_avg_sq = state.exp_avg_sq.mul_scalar(numbers.beta2)
            + gradient.clone().mul_scalar(numbers.share2) * gradient;
        let root = exp_avg_sq.clone().sqrt();
        let denominator = root
            .div_scalar(numbers.root_correction2)
            .add_scalar(numbers.eps);
        let change = exp_avg.clone().mul_scalar(numbers.step_size) / denominator;
        let parameter = state.parameter.mul_scalar(numbers.keep) - change;
        let ema = state.ema.map(|(average, rate)| {
            let distance = parameter.clone() - average.clone();
            (average + distance.mul_scalar(rate as f32), rate)
        });
        AdamWTensors {
            parameter,
            exp_avg,
            exp_avg_sq,
            ema,
        }
    }
}
