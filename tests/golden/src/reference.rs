//! One reference tensor and its comparisons.

use crate::record::{compared, report};

/// One reference tensor: its shape and its values, widened to f64.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Sizes, outermost first; empty for a scalar.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f64>,
}

impl Reference {
    /// The values in single precision.
    pub fn f32s(&self) -> Vec<f32> {
        self.values.iter().map(|&v| v as f32).collect()
    }

    /// The values as non-negative integers.
    pub fn indices(&self) -> Vec<usize> {
        self.values.iter().map(|&v| v as usize).collect()
    }

    /// The only value.
    ///
    /// # Panics
    /// Panics if there are several.
    pub fn scalar(&self) -> f64 {
        assert_eq!(self.values.len(), 1, "not a scalar: shape {:?}", self.shape);
        self.values[0]
    }

    /// The values as vectors of N.
    ///
    /// # Panics Panics if the length is not a multiple of N.
    pub fn vectors<const N: usize>(&self) -> Vec<[f64; N]> {
        let (vectors, rest) = self.values.as_chunks::<N>();
        assert!(rest.is_empty(), "{:?} in vectors of {N}", self.shape);
        vectors.to_vec()
    }

    /// `max|actual - reference|` over the whole tensor.
    ///
    /// # Panics
    /// As [`differences`].
    #[track_caller]
    pub fn largest_difference(&self, what: &str, actual: &[f64]) -> f64 {
        differences(what, actual, &self.values).fold(0.0, f64::max)
    }

    /// `max|actual - reference| / max|reference|`; the difference itself if the reference is 0
    /// everywhere.
    ///
    /// # Panics
    /// As [`largest_difference`](Self::largest_difference).
    #[track_caller]
    pub fn relative_error(&self, what: &str, actual: &[f64]) -> f64 {
        let scale = self.values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let worst = self.largest_difference(what, actual);
        if scale == 0.0 { worst } else { worst / scale }
    }

    /// Asserts `max|actual - reference| <= tolerance * max|reference|` over the whole tensor and
    /// returns the measured ratio.
    ///
    /// # Panics
    /// As [`differences`], and if the bound is exceeded.
    #[track_caller]
    pub fn assert_close(&self, what: &str, actual: &[f64], tolerance: f64) -> f64 {
        let error = self.relative_error(what, actual);
        keep(what, error, tolerance);
        error
    }

    /// Asserts `|actual - reference| <= absolute + relative |reference|` of every value and
    /// returns the largest absolute difference.
    ///
    /// # Panics
    /// As [`differences`], and if the bound is exceeded.
    #[track_caller]
    pub fn assert_within_f64(
        &self,
        what: &str,
        actual: &[f64],
        absolute: f64,
        relative: f64,
    ) -> f64 {
        let mut worst = 0.0f64;
        let errors = differences(what, actual, &self.values).zip(&self.values);
        for (index, (error, r)) in errors.enumerate() {
            let bound = absolute + relative * r.abs();
            assert!(
                error <= bound,
                "{what}[{index}]: off {r} by {error:.3e} of {bound:.1e}"
            );
            worst = worst.max(error);
        }
        report(what, worst, absolute);
        worst
    }

    /// [`assert_within_f64`](Self::assert_within_f64) for single-precision values.
    #[track_caller]
    pub fn assert_within_f32(
        &self,
        what: &str,
        actual: &[f32],
        absolute: f64,
        relative: f64,
    ) -> f64 {
        self.assert_within_f64(what, &wide(actual), absolute, relative)
    }

    /// The part `index` of the first axis.
    ///
    /// # Panics Panics if `index` is out of range.
    pub fn part(&self, index: usize) -> Self {
        let (&parts, shape) = self.shape.split_first().expect("an axis");
        let size = self.values.len() / parts;
        Self {
            shape: shape.to_vec(),
            values: self.values[index * size..(index + 1) * size].to_vec(),
        }
    }

    /// The same without axes of one element between the second and the last: `[batch, channels, 1,
    /// time]` as `[batch, channels, time]`.
    #[must_use]
    pub fn flat(&self) -> Self {
        let last = self.shape.len() - 1;
        let kept = self.shape.iter().enumerate();
        let kept = kept.filter(|&(axis, &size)| size != 1 || axis < 2 || axis == last);
        Self {
            shape: kept.map(|(_, &size)| size).collect(),
            values: self.values.clone(),
        }
    }

    /// [`assert_close`](Self::assert_close) for single-precision values.
    #[track_caller]
    pub fn assert_close_f32(&self, what: &str, actual: &[f32], tolerance: f64) -> f64 {
        self.assert_close(what, &wide(actual), tolerance)
    }
}

/// The elementwise differences of two lists.
///
/// # Panics Panics if the sizes differ, and later if a value of either is not finite, because a
/// maximum ignores NaN.
#[track_caller]
pub fn differences<'a>(
    what: &'a str,
    actual: &'a [f64],
    reference: &'a [f64],
) -> impl Iterator<Item = f64> + 'a {
    assert_eq!(actual.len(), reference.len(), "{what}: number of values");
    compared(reference.len());
    let pairs = actual.iter().zip(reference).enumerate();
    pairs.map(move |(index, (a, r))| {
        assert!(a.is_finite(), "{what}[{index}] is {a}");
        assert!(r.is_finite(), "{what}[{index}] should be {r}");
        (a - r).abs()
    })
}

/// Single-precision values, widened.
pub fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
}

/// Asserts that an error is within its bound, and counts one compared value.
///
/// # Panics Panics if it is not, or if it is NaN.
#[track_caller]
pub fn bound(what: &str, error: f64, tolerance: f64) {
    compared(1);
    keep(what, error, tolerance);
}

/// [`bound`] without counting.
#[track_caller]
pub(crate) fn keep(what: &str, error: f64, tolerance: f64) {
    report(what, error, tolerance);
    assert!(
        error <= tolerance,
        "{what}: error {error:.3e} exceeds {tolerance:.1e}"
    );
}
