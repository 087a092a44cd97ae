//! NumPy arrays to and from vectors.

use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, ToPyArray};
use pyo3::prelude::*;

/// A row-major float32 array of this shape.
///
/// # Errors
/// If the shape does not match the number of values.
pub fn array<'py>(
    py: Python<'py>,
    shape: &[usize],
    values: &[f32],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    values.to_pyarray(py).reshape(shape.to_vec())
}

/// A row-major float64 array of this shape.
///
/// # Errors
/// If the shape does not match the number of values.
pub fn double<'py>(
    py: Python<'py>,
    shape: &[usize],
    values: &[f64],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    values.to_pyarray(py).reshape(shape.to_vec())
}

/// Shape and row-major values of an array in any memory order.
pub fn shape_and_values<T: numpy::Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
) -> (Vec<usize>, Vec<T>) {
    let view = array.as_array();
    (view.shape().to_vec(), view.iter().copied().collect())
}
