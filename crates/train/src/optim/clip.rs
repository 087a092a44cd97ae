use rayon::prelude::*;

/// Elements of one partial sum. Fixed, so that the order of additions, and with it the last bit
/// of the norm, does not depend on the number of threads.
const CHUNK: usize = 1 << 16;

/// The Euclidean norm over all tensors together, in f64.
pub fn global_norm(gradients: &[Vec<f32>]) -> f64 {
    let sum = |values: &[f32]| {
        let partial: Vec<f64> = values
            .par_chunks(CHUNK)
            .map(|chunk| chunk.iter().map(|&g| f64::from(g) * f64::from(g)).sum())
            .collect();
        partial.iter().sum::<f64>()
    };
    gradients
        .iter()
        .map(|values| sum(values))
        .sum::<f64>()
        .sqrt()
}

/// What gradients of global norm `norm` are multiplied by to keep it at most `max_norm`; 1 when
/// `max_norm` is 0, which switches clipping off.
pub fn clip_factor(norm: f64, max_norm: f64) -> f64 {
    if max_norm == 0.0 {
        1.0
    } else {
        (max_norm / (norm + 1e-6)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_norm_is_the_same_with_any_number_of_threads() {
        let gradients: Vec<Vec<f32>> = vec![
            (0..300_000).map(|i| (i as f32 * 0.37).sin()).collect(),
            vec![2.0; 10],
        ];
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool");
            pool.install(|| global_norm(&gradients)).to_bits()
        };
        assert_eq!(with(1), with(2));
        assert_eq!(with(1), with(7));
    }

    #[test]
    fn zero_switches_clipping_off() {
        assert_eq!(clip_factor(50.0, 0.0), 1.0);
        assert!((clip_factor(50.0, 1.0) - 0.02).abs() < 1e-9);
        assert_eq!(clip_factor(0.5, 1.0), 1.0);
    }
}
