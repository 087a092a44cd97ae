//! Which numbers motion, music and texts may hold.

/// Largest magnitude of a number that is trained on, in the units of its file.
///
/// Training multiplies such values with each other in single precision, which ends at 3.4e38: the
/// losses square the motion's changes, and gradients through the sampler are products of features,
/// activations and those. A small network whose motion and features all reach 1e8 overflows in its
/// first steps of recipe `e2e`, one at 3e7 trains. Motion in metres is smaller by orders.
pub const LARGEST: f32 = 1e6;

/// Whether a value is finite and not too large to train on.
pub(crate) fn is_usable(value: f32) -> bool {
    // False for NaN.
    value.abs() <= LARGEST
}

/// Place of the first value that is not usable.
pub(crate) fn first_unusable(values: &[f32]) -> Option<usize> {
    // Without branches, which is quick, for all but the bad ones.
    let all = values
        .iter()
        .fold(true, |all, &value| all & is_usable(value));
    match all {
        true => None,
        false => values.iter().position(|&value| !is_usable(value)),
    }
}

/// What is allowed in the place of a value that is not usable, and how to mend it.
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
