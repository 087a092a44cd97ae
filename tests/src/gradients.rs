//! Gradients of networks compared with those of golden files.

use burn::module::Module;
use kinegrad_models::parameters;

use crate::golden::Golden;

/// Below this a gradient is zero in exact arithmetic.
const ZERO: f64 = 1e-6;

/// Compares the stored gradients (`grad.model.*`) of `module`'s parameters with `gradients`, which
/// are in the module's order: `tolerance` of the largest of each parameter.
///
/// # Panics Panics if one differs, or if a stored gradient belongs to no parameter.
pub fn compare<M: Module>(golden: &Golden, module: &M, gradients: &[Vec<f32>], tolerance: f64) {
    compare_under(golden, module, gradients, "grad.model.", tolerance);
}

/// [`compare`] with the gradients under `prefix`.
///
/// # Panics
/// As [`compare`].
pub fn compare_under<M: Module>(
    golden: &Golden,
    module: &M,
    gradients: &[Vec<f32>],
    prefix: &str,
    tolerance: f64,
) {
    let infos = parameters::infos(module);
    let stored = golden.names_under(prefix);
    let mut compared = 0;
    for (info, gradient) in infos.iter().zip(gradients) {
        if !stored.contains(&info.name) {
            continue;
        }
        compared += 1;
        let name = format!("{prefix}{}", info.name);
        let reference = golden.get(&name);
        let largest = reference.values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if largest < ZERO {
            // Rounding noise in both.
            reference.assert_within_f32(&name, gradient, ZERO, 0.0);
        } else {
            reference.assert_close_f32(&name, gradient, tolerance);
        }
    }
    assert_eq!(compared, stored.len(), "every stored gradient");
}
