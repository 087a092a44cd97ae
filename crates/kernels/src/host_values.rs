use burn::tensor::Tensor;

/// The numbers of a tensor on the host, in memory order.
///
/// # Panics
/// Panics if numbers cannot be read as float32.
pub fn host_values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as().expect("float numbers")
}
