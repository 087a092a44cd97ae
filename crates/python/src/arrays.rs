//! Conversions between NumPy arrays and vectors.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, ToPyArray};
use pyo3::prelude::*;

/// A row-major array of this shape.
///
/// # Errors
/// If the shape does not match the number of values.
pub fn array<'py, T: Element + Copy>(
    py: Python<'py>,
    shape: &[usize],
    values: &[T],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    values.to_pyarray(py).reshape(shape.to_vec())
}

/// Shape and row-major values of an array in any memory order.
pub fn shape_and_values<T: Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
) -> (Vec<usize>, Vec<T>) {
    let view = array.as_array();
    (view.shape().to_vec(), view.iter().copied().collect())
}
