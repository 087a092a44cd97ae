//! Initial weights: keyed by the parameter's name, so that they depend on the seed alone.

use burn::module::{Param, ParamId};
use burn::tensor::{Device, Shape, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

/// Makes parameters at one place of a network's tree; [`at`](Self::at) descends.
///
/// Parameters are lazy: a network whose parameters are only counted, or are loaded from a file,
/// draws nothing.
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

    /// The place `name` below this one.
    #[must_use]
    pub fn at(&self, name: &str) -> Self {
        Self {
            key: self.key.named(name),
            device: self.device.clone(),
        }
    }

    /// A parameter drawn uniformly from `+-1 / sqrt(fan_in)`, the default of PyTorch's linear and
    /// convolution layers for weight and bias alike.
    pub fn uniform<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
        fan_in: usize,
    ) -> Param<Tensor<D>> {
        self.bounded(name, shape, 1.0 / (fan_in as f64).sqrt())
    }

    /// A parameter drawn uniformly from `+-bound`.
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

    /// A parameter of the given values, row by row.
    ///
    /// # Panics
    /// Panics, when it is first used, if there are not as many as the shape has places.
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
