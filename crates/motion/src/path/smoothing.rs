//! Savitzky-Golay filters (1964): the value of the best-fitting polynomial around each frame.

use nalgebra::{DMatrix, DVector};

/// Window for headings, frames.
pub const HEADING_WINDOW: usize = 11;

/// Polynomial order for headings.
pub const HEADING_ORDER: usize = 3;

/// Values beyond both ends.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub enum Edges {
    /// No values: the polynomials of the first and last window are extrapolated.
    #[default]
    Fitted,
    /// The first and the last value.
    Nearest,
    /// Mirrored values.
    Mirror,
}

/// Weights of the `window` values around a frame. The weighted sum is the value, or `derivative`,
/// of the fitted polynomial of `order` at offset `at` from the middle.
///
/// # Panics
/// Panics unless `window` is odd and greater than `order`.
pub fn savgol_weights(window: usize, order: usize, at: f64, derivative: usize) -> Vec<f64> {
    let valid = window % 2 == 1 && order < window;
    assert!(valid, "{window} frames, order {order}");
    let half = (window / 2) as f64;
    // Offsets from -1 to 1 give well-conditioned powers.
    let scale = half.max(1.0);
    let offsets = |i: usize| (i as f64 - half) / scale;
    let powers = DMatrix::from_fn(window, order + 1, |i, p| offsets(i).powi(p as i32));
    let wanted = DVector::from_fn(order + 1, |p, _| match p < derivative {
        true => 0.0,
        false => {
            let factor: f64 = (p + 1 - derivative..=p).map(|k| k as f64).product();
            factor * (at / scale).powi((p - derivative) as i32) / scale.powi(derivative as i32)
        }
    });
    // The smallest weights w with powers^T w = wanted: Q R^-T wanted.
    let decomposed = powers.qr();
    let solved = decomposed
        .r()
        .transpose()
        .solve_lower_triangular(&wanted)
        .expect("powers of different offsets are independent");
    (decomposed.q() * solved).iter().copied().collect()
}

/// `values` smoothed with `window` frames. Shorter lists use the largest possible odd window and,
/// if needed, a lower order. Fewer than 3 values stay.
///
/// # Panics
/// Panics unless `window` is odd and greater than `order`.
pub fn savgol(values: &[f64], window: usize, order: usize, edges: Edges) -> Vec<f64> {
    let n = values.len();
    let longest = if n % 2 == 1 { n } else { n.saturating_sub(1) };
    let window = window.min(longest);
    if window < 3 {
        return values.to_vec();
    }
    let order = order.min(window - 1);
    let half = window / 2;
    let inner = savgol_weights(window, order, 0.0, 0);
    let sum = |weights: &[f64], around: &[f64]| -> f64 {
        let products = weights.iter().zip(around);
        products.map(|(weight, value)| weight * value).sum()
    };
    let smoothed = |t: usize| {
        if t >= half && t + half < n {
            return sum(&inner, &values[t - half..=t + half]);
        }
        match edges {
            Edges::Fitted => {
                let first = if t < half { 0 } else { n - window };
                let at = t as f64 - (first + half) as f64;
                let weights = savgol_weights(window, order, at, 0);
                sum(&weights, &values[first..first + window])
            }
            Edges::Nearest | Edges::Mirror => {
                let last = n as i64 - 1;
                let place = |offset: usize| {
                    let t = t as i64 + offset as i64 - half as i64;
                    let inside = match edges {
                        Edges::Mirror if t < 0 => -t,
                        Edges::Mirror if t > last => 2 * last - t,
                        _ => t.clamp(0, last),
                    };
                    values[inside as usize]
                };
                let around: Vec<f64> = (0..window).map(place).collect();
                sum(&inner, &around)
            }
        }
    };
    (0..n).map(smoothed).collect()
}

/// A ground track with each axis [smoothed](savgol) and fitted ends.
pub fn smoothed(track: &[[f64; 2]], window: usize, order: usize) -> Vec<[f64; 2]> {
    let axis = |i: usize| {
        let values: Vec<f64> = track.iter().map(|point| point[i]).collect();
        savgol(&values, window, order, Edges::Fitted)
    };
    let points = axis(0).into_iter().zip(axis(1));
    points.map(|(x, z)| [x, z]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_stays_as_it_is_and_its_slope_is_found() {
        let cubic = |t: f64| 0.5 - 0.2 * t + 0.03 * t * t - 0.001 * t * t * t;
        let values: Vec<f64> = (0..30).map(|t| cubic(f64::from(t))).collect();
        let smoothed = savgol(&values, HEADING_WINDOW, HEADING_ORDER, Edges::Fitted);
        for (a, b) in smoothed.iter().zip(&values) {
            assert!((a - b).abs() < 1e-9);
        }
        let slopes = savgol_weights(7, 3, 1.0, 1);
        let found: f64 = slopes.iter().zip(&values[4..11]).map(|(w, v)| w * v).sum();
        let slope = -0.2 + 0.06 * 8.0 - 0.003 * 64.0;
        assert!((found - slope).abs() < 1e-9, "{found} {slope}");
    }

    #[test]
    fn short_lists_have_shorter_windows() {
        let bumpy = [0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0];
        for n in 0..3 {
            assert_eq!(savgol(&bumpy[..n], 11, 3, Edges::Fitted), &bumpy[..n]);
        }
        // A parabola through three points.
        let three = savgol(&bumpy[..3], 11, 3, Edges::Fitted);
        assert!(three.iter().zip(&bumpy).all(|(a, b)| (a - b).abs() < 1e-12));
        let smoothed = savgol(&bumpy, 11, 3, Edges::Fitted);
        assert!(
            smoothed
                .iter()
                .zip(&bumpy)
                .any(|(a, b)| (a - b).abs() > 0.1)
        );
    }
}
