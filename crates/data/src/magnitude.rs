//! Allowed magnitude of numbers in datasets.

/// Largest magnitude of a number, in the units of its file.
///
/// Training multiplies such values in single precision, up to 3.4e38. A small network overflows
/// in the first steps of recipe `e2e` if motion and features reach 1e8; with 3e7 it trains.
pub const LARGEST: f32 = 1e6;

/// True if a value is finite and not too large.
pub(crate) fn is_usable(value: f32) -> bool {
    // The comparison is false for NaN.
    value.abs() <= LARGEST
}

/// Index of the first unusable value.
pub(crate) fn first_unusable(values: &[f32]) -> Option<usize> {
    // A loop without branches is faster for valid data.
    let all = values
        .iter()
        .fold(true, |all, &value| all & is_usable(value));
    match all {
        true => None,
        false => values.iter().position(|&value| !is_usable(value)),
    }
}

/// A description of the allowed values for an unusable `value`, and a hint.
pub(crate) fn allowed(value: f32) -> (String, &'static str) {
    match value.is_finite() {
        false => (
            "finite numbers".to_owned(),
            "repair or leave out the phrase; kinegrad never fills gaps by itself",
        ),
        true => (
            format!("numbers from -{LARGEST:e} to {LARGEST:e}"),
            "check the units: training computes squares of these numbers in single precision",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_numbers_up_to_the_bound_are_usable() {
        for value in [0.0, -LARGEST, LARGEST, f32::MIN_POSITIVE] {
            assert!(is_usable(value));
        }
        for value in [f32::NAN, f32::NEG_INFINITY, 1.1e6, -1e30] {
            assert!(!is_usable(value));
        }
        assert_eq!(allowed(1e19).0, "numbers from -1e6 to 1e6");
    }
}
