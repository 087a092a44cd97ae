//! The optimizer's step in host memory: one pass over the gradients for their norm, then one
//! in-place pass for clipping, AdamW and the moving average.

mod tensors;

pub use tensors::AdamWTensors;

use crate::host::simd::vectorized;
use crate::host::team;

/// Elements of a task. The number is fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;

/// Parallel sums within a chunk, for vectorization.
const LANES: usize = 32;

/// The sum of the squares of `values`, in double precision and in a fixed order.
pub fn sum_of_squares(values: &[f32]) -> f64 {
    let chunks: Vec<&[f32]> = values.chunks(CHUNK).collect();
    let partial = team::map(chunks.len(), |i| {
        vectorized(
            #[inline(always)]
            || chunk_sum_of_squares(chunks[i]),
        )
    });
    partial.iter().sum()
}

#[inline(always)]
fn chunk_sum_of_squares(chunk: &[f32]) -> f64 {
    let mut sums = [0.0_f64; LANES];
    let (lines, rest) = chunk.as_chunks::<LANES>();
    for line in lines {
        for (sum, value) in sums.iter_mut().zip(line) {
            *sum += f64::from(*value) * f64::from(*value);
        }
    }
    for (sum, value) in sums.iter_mut().zip(rest) {
        *sum += f64::from(*value) * f64::from(*value);
    }
    sums.iter().sum()
}

/// Divides each value in double precision.
pub fn divide(values: &mut [f32], divisor: f64) {
    team::for_each_item(values.chunks_mut(CHUNK).collect(), |chunk: &mut [f32]| {
        vectorized(
            #[inline(always)]
            || {
                let values = chunk.iter_mut();
                values.for_each(|value| *value = (f64::from(*value) / divisor) as f32);
            },
        );
    });
}

/// The settings of one AdamW step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamW {
    /// Decay of the running means of gradient and squared gradient.
    pub betas: [f64; 2],
    /// Added to the denominator.
    pub eps: f64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// Number of this step, from 1.
    pub steps: u64,
    /// Factor of the gradient, for clipping.
    pub gradient_scale: f64,
}

/// State of one parameter.
pub struct AdamWState<'a> {
    /// The values.
    pub parameter: &'a mut [f32],
    /// Running mean of the gradient.
    pub exp_avg: &'a mut [f32],
    /// Running mean of the squared gradient.
    pub exp_avg_sq: &'a mut [f32],
    /// The moving average of the values, and its rate.
    pub ema: Option<(&'a mut [f32], f64)>,
}

/// [`AdamW`] in single precision.
#[derive(Clone, Copy)]
struct Coefficients {
    beta1: f32,
    beta2: f32,
    share1: f32,
    share2: f32,
    keep: f32,
    step_size: f32,
    root_correction2: f32,
    eps: f32,
    scale: f32,
}

impl AdamW {
    fn coefficients(&self) -> Coefficients {
        let [beta1, beta2] = self.betas;
        let correction = |beta: f64| 1.0 - beta.powi(self.steps as i32);
        Coefficients {
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            share1: (1.0 - beta1) as f32,
            share2: (1.0 - beta2) as f32,
            keep: (1.0 - self.learning_rate * self.weight_decay) as f32,
            step_size: (self.learning_rate / correction(beta1)) as f32,
            root_correction2: correction(beta2).sqrt() as f32,
            eps: self.eps as f32,
            scale: self.gradient_scale as f32,
        }
    }

    /// Adam with decoupled weight decay, then the moving average, in one pass:
    ///
    /// ```text
    /// g *= gradient_scale
    /// p -= lr decay p
    /// m  = b1 m + (1 - b1) g
    /// v  = b2 v + (1 - b2) g^2
    /// p -= lr mhat / (sqrt(vhat) + eps)    with  mhat = m / (1 - b1^t),  vhat = v / (1 - b2^t)
    /// s += rate (p - s)
    /// ```
    ///
    /// # Panics
    /// Panics if the lengths differ.
    pub fn update(&self, state: AdamWState<'_>, gradient: &[f32]) {
        let AdamWState {
            parameter,
            exp_avg,
            exp_avg_sq,
            ema,
        } = state;
        let len = parameter.len();
        assert_eq!(gradient.len(), len, "gradient");
        assert_eq!(
            (exp_avg.len(), exp_avg_sq.len()),
            (len, len),
            "running means"
        );
        let coefficients = self.coefficients();
        let chunks = parameter
            .chunks_mut(CHUNK)
            .zip(gradient.chunks(CHUNK))
            .zip(exp_avg.chunks_mut(CHUNK))
            .zip(exp_avg_sq.chunks_mut(CHUNK));
        match ema {
            Some((shadow, rate)) => {
                assert_eq!(shadow.len(), len, "moving average");
                let rate = rate as f32;
                let chunks = chunks.zip(shadow.chunks_mut(CHUNK)).collect();
                team::for_each_item(chunks, |((((p, g), m), v), s)| {
                    let (p, s): (&mut [f32], &mut [f32]) = (p, s);
                    vectorized(
                        #[inline(always)]
                        || {
                            let pairs = p.iter_mut().zip(g).zip(m.iter_mut().zip(v.iter_mut()));
                            for (((p, g), (m, v)), s) in pairs.zip(s.iter_mut()) {
                                *p = coefficients.step(*p, *g, m, v);
                                *s += rate * (*p - *s);
                            }
                        },
                    );
                });
            }
            None => team::for_each_item(chunks.collect(), |(((p, g), m), v)| {
                vectorized(
                    #[inline(always)]
                    || {
                        for ((p, g), (m, v)) in
                            p.iter_mut().zip(g).zip(m.iter_mut().zip(v.iter_mut()))
                        {
                            *p = coefficients.step(*p, *g, m, v);
                        }
                    },
                );
            }),
        }
    }
}

impl Coefficients {
    #[inline(always)]
    fn step(&self, parameter: f32, gradient: f32, exp_avg: &mut f32, exp_avg_sq: &mut f32) -> f32 {
        let g = gradient * self.scale;
        *exp_avg = self.beta1 * *exp_avg + self.share1 * g;
        *exp_avg_sq = self.beta2 * *exp_avg_sq + self.share2 * g * g;
        let denominator = exp_avg_sq.sqrt() / self.root_correction2 + self.eps;
        parameter * self.keep - self.step_size * *exp_avg / denominator
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, rate: f32) -> Vec<f32> {
        (0..n).map(|i| (i as f32 * rate).sin()).collect()
    }

    #[test]
    fn a_sum_of_squares_is_the_same_with_any_number_of_threads() {
        let values = wave(300_001, 0.37);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool");
            pool.install(|| sum_of_squares(&values)).to_bits()
        };
        assert_eq!(with(1), with(2));
        assert_eq!(with(1), with(7));
        let plain: f64 = values.iter().map(|&v| f64::from(v).powi(2)).sum();
        assert!((f64::from_bits(with(2)) / plain - 1.0).abs() < 1e-12);
    }

    #[test]
    fn values_are_divided_in_double_precision() {
        let mut values = wave(CHUNK + 3, 0.37);
        let expected = values.iter().map(|value| (f64::from(*value) / 3.7) as f32);
        let expected: Vec<f32> = expected.collect();
        divide(&mut values, 3.7);
        assert_eq!(values, expected);
    }

    #[test]
    fn a_step_agrees_with_double_precision() {
        let step = AdamW {
            betas: [0.9, 0.99],
            eps: 1e-8,
            weight_decay: 0.1,
            learning_rate: 0.01,
            steps: 3,
            gradient_scale: 0.5,
        };
        let n = CHUNK + 77;
        let (mut p, g) = (wave(n, 0.1), wave(n, 0.23));
        let (mut m, mut s) = (wave(n, 0.05), wave(n, 0.4));
        let mut v: Vec<f32> = wave(n, 0.07).iter().map(|v| v * v).collect();
        let before = (p.clone(), m.clone(), v.clone(), s.clone());
        step.update(
            AdamWState {
                parameter: &mut p,
                exp_avg: &mut m,
                exp_avg_sq: &mut v,
                ema: Some((&mut s, 0.25)),
            },
            &g,
        );
        for i in 0..n {
            let old = |values: &[f32]| f64::from(values[i]);
            let gradient = 0.5 * f64::from(g[i]);
            let mean = 0.9 * old(&before.1) + 0.1 * gradient;
            let square = 0.99 * old(&before.2) + 0.01 * gradient * gradient;
            let root = (square / (1.0 - 0.99_f64.powi(3))).sqrt() + 1e-8;
            let value =
                old(&before.0) * (1.0 - 0.001) - 0.01 * mean / (1.0 - 0.9_f64.powi(3)) / root;
            let average = old(&before.3) + 0.25 * (value - old(&before.3));
            for (found, expected) in [(p[i], value), (m[i], mean), (v[i], square), (s[i], average)]
            {
                let error = (f64::from(found) - expected).abs();
                assert!(
                    error < 2e-6 * expected.abs().max(1.0),
                    "{found}, {expected}"
                );
            }
        }
    }
}
