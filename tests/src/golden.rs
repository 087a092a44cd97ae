//! Reference tensors on a device.

use burn::tensor::{Device, Tensor, TensorData};
pub use kinegrad_golden::{Folder, Golden, Reference, compared, differences, wide, workspace};

/// Tensors of a file.
pub trait GoldenTensors {
    /// The tensor `name` on `device`.
    fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D>;
}

impl GoldenTensors for Golden {
    fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D> {
        self.get(name).tensor(device)
    }
}

/// A reference as a tensor, and its comparison with a tensor.
pub trait ReferenceTensors {
    /// The values on `device`.
    fn tensor<const D: usize>(&self, device: &Device) -> Tensor<D>;

    /// [`Reference::assert_close`] for a tensor, whose shape must be the reference's.
    fn assert_close_tensor<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        tolerance: f64,
    ) -> f64;

    /// [`Reference::assert_within_f32`] for a tensor.
    fn assert_within<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        absolute: f64,
        relative: f64,
    ) -> f64;
}

impl ReferenceTensors for Reference {
    fn tensor<const D: usize>(&self, device: &Device) -> Tensor<D> {
        Tensor::from_data(TensorData::new(self.f32s(), self.shape.clone()), device)
    }

    #[track_caller]
    fn assert_close_tensor<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        tolerance: f64,
    ) -> f64 {
        assert_eq!(actual.dims().to_vec(), self.shape, "{what}: shape");
        self.assert_close_f32(what, &values(actual), tolerance)
    }

    #[track_caller]
    fn assert_within<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        absolute: f64,
        relative: f64,
    ) -> f64 {
        self.assert_within_f32(what, &values(actual), absolute, relative)
    }
}

/// The values of a float32 tensor on the host.
///
/// # Panics Panics if the type is another.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().expect("a float32 tensor")
}
