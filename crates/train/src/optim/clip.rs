use kinegrad_kernels::optimizer::sum_of_squares;

/// The sum of the squares of each tensor, in f64.
pub fn squares(gradients: &[Vec<f32>]) -> Vec<f64> {
    let squares = gradients.iter().map(|values| sum_of_squares(values));
    squares.collect()
}

/// The global Euclidean norm from [`squares`], in a fixed order.
pub fn norm_of_squares(squares: &[f64]) -> f64 {
    squares.iter().sum::<f64>().sqrt()
}

/// The factor that limits gradients of norm `norm` to `max_norm`; 0 disables clipping.
pub fn clip_factor(norm: f64, max_norm: f64) -> f64 {
    match max_norm == 0.0 {
        true => 1.0,
        false => (max_norm / (norm + 1e-6)).min(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_switches_clipping_off() {
        assert_eq!(clip_factor(50.0, 0.0), 1.0);
        assert!((clip_factor(50.0, 1.0) - 0.02).abs() < 1e-9);
        assert_eq!(clip_factor(0.5, 1.0), 1.0);
    }
}
