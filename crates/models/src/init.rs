//! Initial weights, keyed by the parameter's name.

use burn::module::{Param, ParamId, RunningState};
use burn::tensor::{Device, Shape, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

/// Initializes the parameters of one node of a network's module tree; [`at`](Self::at) descends.
///
/// Parameters are lazy: counting parameters or loading a file does not initialize them.
#[derive(Clone, Debug)]
pub struct Initializer {
    key: Key,
    device: Device,
}

impl Initializer {
    /// The root of a network on `device`; pass an autodiff device to train.
    pub fn new(seed: u64, device: &Device) -> Self {
        Self {
            key: Key::new(seed, Purpose::Init),
            device: device.clone(),
        }
    }

    /// The child `name` of this node.
    #[must_use]
    pub fn at(&self, name: &str) -> Self {
        Self {
            key: self.key.named(name),
            device: self.device.clone(),
        }
    }

    /// A parameter sampled uniformly from `+-1 / sqrt(fan_in)`. PyTorch's linear and convolution
    /// layers use this default for weights and biases.
    pub fn uniform<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
        fan_in: usize,
    ) -> Param<Tensor<D>> {
        self.bounded(name, shape, 1.0 / (fan_in as f64).sqrt())
    }

    /// A parameter sampled uniformly from `+-bound`.
    pub fn bounded<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
        bound: f64,
    ) -> Param<Tensor<D>> {
        let key = self.key.named(name);
        self.parameter(shape, move |n| {
            let uniforms = key.uniforms(n);
            uniforms
                .into_iter()
                .map(|u| ((2.0 * f64::from(u) - 1.0) * bound) as f32)
                .collect()
        })
    }

    /// A parameter whose elements are all `value`.
    pub fn constant<const D: usize>(&self, shape: [usize; D], value: f32) -> Param<Tensor<D>> {
        self.parameter(shape, move |n| vec![value; n])
    }

    /// A running statistic whose elements are all `value`.
    pub fn running<const D: usize>(
        &self,
        shape: [usize; D],
        value: f32,
    ) -> RunningState<Tensor<D>> {
        RunningState::new(Tensor::full(shape, value, &self.device))
    }

    /// A parameter with these row-major values.
    ///
    /// # Panics
    /// The first use panics if the number of values does not fit the shape.
    pub fn values<const D: usize>(&self, shape: [usize; D], values: Vec<f32>) -> Param<Tensor<D>> {
        self.parameter(shape, move |_| values)
    }

    fn parameter<const D: usize>(
        &self,
        shape: [usize; D],
        values: impl FnOnce(usize) -> Vec<f32> + Send + Sync + 'static,
    ) -> Param<Tensor<D>> {
        Param::uninitialized(
            ParamId::new(),
            move |device, require_grad| {
                let values = values(shape.iter().product());
                Tensor::from_data(TensorData::new(values, shape), device)
                    .set_require_grad(require_grad)
            },
            self.device.clone(),
            true,
            Shape::from(shape),
        )
    }
}
