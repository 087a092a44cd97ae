//! Layer normalization of rows, in one forward and one backward pass.

use super::simd::vectorized;
use super::team;

/// Approximate number of elements per chunk. Chunks, and so the sums over rows, do not depend on
/// the number of threads.
const CHUNK: usize = 1 << 13;

/// Minimum number of rows per chunk, because each chunk has its own sums.
const LEAST_ROWS: usize = 8;

/// Parallel partial sums, for vectorization.
const LANES: usize = 16;

/// Rows `[rows, features]` and their normalization.
#[derive(Clone, Copy)]
pub(crate) struct LayerNormRows<'a> {
    /// The rows, without gaps.
    pub x: &'a [f32],
    /// Scale of each feature.
    pub weight: &'a [f32],
    /// Added to the variance.
    pub eps: f64,
}

/// The gradient of a chunk's rows, and its sums for scales and shifts.
type Outputs<'a> = (&'a mut [f32], &'a mut [f32]);

/// A chunk's rows, and the gradient of their output.
type Inputs<'a> = (&'a [f32], &'a [f32]);

impl LayerNormRows<'_> {
    fn features(&self) -> usize {
        self.weight.len()
    }

    /// Elements of a chunk.
    fn chunk(&self) -> usize {
        (CHUNK / self.features()).max(LEAST_ROWS) * self.features()
    }

    /// `(x - mean) / sqrt(variance + eps) weight + bias` of each row.
    pub fn forward(&self, bias: &[f32]) -> Vec<f32> {
        let (features, chunk) = (self.features(), self.chunk());
        let mut y = vec![0.0; self.x.len()];
        let chunks = y.chunks_mut(chunk).zip(self.x.chunks(chunk)).collect();
        team::for_each_item(chunks, |(y, x): (&mut [f32], &[f32])| {
            vectorized(
                #[inline(always)]
                || {
                    for (y, x) in y.chunks_exact_mut(features).zip(x.chunks_exact(features)) {
                        let [mean, reciprocal] = moments(x, self.eps);
                        let parameters = self.weight.iter().zip(bias);
                        for ((y, x), (weight, bias)) in y.iter_mut().zip(x).zip(parameters) {
                            *y = (x - mean) * reciprocal * weight + bias;
                        }
                    }
                },
            );
        });
        y
    }

    /// The gradients of the rows, scales and shifts, from the gradient of the output.
    ///
    /// With `n` the normalized values and `d` the output's gradient times the weight:
    /// `dx = (d - mean(d) - n mean(d n)) / sqrt(variance + eps)`.
    pub fn backward(&self, gradient: &[f32]) -> [Vec<f32>; 3] {
        let (features, chunk) = (self.features(), self.chunk());
        let mut dx = vec![0.0; self.x.len()];
        let inputs = self.x.chunks(chunk).zip(gradient.chunks(chunk));
        let mut sums = vec![0.0; 2 * features * self.x.len().div_ceil(chunk)];
        let outputs = dx.chunks_mut(chunk).zip(sums.chunks_mut(2 * features));
        let chunks = outputs.zip(inputs).collect();
        team::for_each_item(
            chunks,
            |((dx, sums), (x, gradient)): (Outputs<'_>, Inputs<'_>)| {
                let (weight, bias) = sums.split_at_mut(features);
                vectorized(
                    #[inline(always)]
                    || {
                        let inputs = x
                            .chunks_exact(features)
                            .zip(gradient.chunks_exact(features));
                        for (dx, (x, gradient)) in dx.chunks_exact_mut(features).zip(inputs) {
                            self.backward_row(dx, x, gradient, [&mut *weight, &mut *bias]);
                        }
                    },
                );
            },
        );
        let (mut weight, mut bias) = (vec![0.0; features], vec![0.0; features]);
        for sums in sums.chunks_exact(2 * features) {
            let (of_weight, of_bias) = sums.split_at(features);
            for (sum, part) in weight.iter_mut().zip(of_weight) {
                *sum += part;
            }
            for (sum, part) in bias.iter_mut().zip(of_bias) {
                *sum += part;
            }
        }
        [dx, weight, bias]
    }

    #[inline(always)]
    fn backward_row(
        &self,
        dx: &mut [f32],
        x: &[f32],
        gradient: &[f32],
        [weight_sums, bias_sums]: [&mut [f32]; 2],
    ) {
        let [mean, reciprocal] = moments(x, self.eps);
        // `dx` contains the normalized values until the last loop.
        let sums = weight_sums.iter_mut().zip(bias_sums);
        for (((dx, x), gradient), (weight, bias)) in dx.iter_mut().zip(x).zip(gradient).zip(sums) {
            let normalized = (x - mean) * reciprocal;
            *dx = normalized;
            *weight += gradient * normalized;
            *bias += gradient;
        }
        let count = x.len() as f32;
        let mean_d = sum(gradient, self.weight, |d, weight| d * weight) / count;
        let mut lanes = [0.0; LANES];
        let (dx_lanes, dx_rest) = dx.as_chunks::<LANES>();
        let (gradient_lanes, gradient_rest) = gradient.as_chunks::<LANES>();
        let (weight_lanes, weight_rest) = self.weight.as_chunks::<LANES>();
        for ((n, d), weight) in dx_lanes.iter().zip(gradient_lanes).zip(weight_lanes) {
            for (i, lane) in lanes.iter_mut().enumerate() {
                *lane += n[i] * d[i] * weight[i];
            }
        }
        for (i, n) in dx_rest.iter().enumerate() {
            lanes[i] += n * gradient_rest[i] * weight_rest[i];
        }
        let mean_dn = total(lanes) / count;
        for ((dx, gradient), weight) in dx.iter_mut().zip(gradient).zip(self.weight) {
            *dx = (gradient * weight - mean_d - *dx * mean_dn) * reciprocal;
        }
    }
}

/// Mean and reciprocal deviation of a row, in two passes, so that a large mean loses few digits.
#[inline(always)]
fn moments(x: &[f32], eps: f64) -> [f32; 2] {
    let count = x.len() as f32;
    let mean = sum(x, x, |x, _| x) / count;
    let variance = sum(x, x, |x, _| (x - mean) * (x - mean)) / count;
    let reciprocal = (f64::from(variance) + eps).sqrt().recip() as f32;
    [mean, reciprocal]
}

/// The sum of `of(a, b)` over the features.
#[inline(always)]
fn sum(a: &[f32], b: &[f32], of: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for (i, lane) in lanes.iter_mut().enumerate() {
            *lane += of(a[i], b[i]);
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(a_rest.iter().zip(b_rest)) {
        *lane += of(*a, *b);
    }
    total(lanes)
}

/// The sum of the lanes, in halves.
#[inline(always)]
fn total(mut lanes: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            lanes[i] += lanes[i + half];
        }
        half /= 2;
    }
    lanes[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition in double precision: output, and gradients of rows, scales and shifts.
    fn expected(
        x: &[f32],
        weight: &[f32],
        bias: &[f32],
        gradient: &[f32],
        eps: f64,
    ) -> [Vec<f64>; 4] {
        let features = weight.len();
        let (mut y, mut dx) = (Vec::new(), Vec::new());
        let (mut dw, mut db) = (vec![0.0; features], vec![0.0; features]);
        for (x, gradient) in x.chunks(features).zip(gradient.chunks(features)) {
            let x: Vec<f64> = x.iter().map(|&x| f64::from(x)).collect();
            let mean = x.iter().sum::<f64>() / features as f64;
            let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / features as f64;
            let deviation = (variance + eps).sqrt();
            let n: Vec<f64> = x.iter().map(|x| (x - mean) / deviation).collect();
            let d: Vec<f64> = (0..features)
                .map(|i| f64::from(gradient[i]) * f64::from(weight[i]))
                .collect();
            let mean_d = d.iter().sum::<f64>() / features as f64;
            let mean_dn = d.iter().zip(&n).map(|(d, n)| d * n).sum::<f64>() / features as f64;
            for i in 0..features {
                y.push(n[i] * f64::from(weight[i]) + f64::from(bias[i]));
                dx.push((d[i] - mean_d - n[i] * mean_dn) / deviation);
                dw[i] += f64::from(gradient[i]) * n[i];
                db[i] += f64::from(gradient[i]);
            }
        }
        [y, dx, dw, db]
    }

    #[test]
    fn rows_of_any_width_are_normalised_and_differentiated() {
        for (rows, features, offset) in [(1, 1, 0.0), (3, 7, 0.0), (700, 20, 5.0), (2, 9000, -3.0)]
        {
            let wave = |i: usize, speed: f32| ((i as f32) * speed).sin();
            let x: Vec<f32> = (0..rows * features)
                .map(|i| wave(i, 0.7) + offset)
                .collect();
            let gradient: Vec<f32> = (0..rows * features).map(|i| wave(i, 1.3)).collect();
            let weight: Vec<f32> = (0..features).map(|i| 1.0 + wave(i, 0.3) / 2.0).collect();
            let bias: Vec<f32> = (0..features).map(|i| wave(i, 0.9)).collect();
            let eps = 1e-5;
            let norm = LayerNormRows {
                x: &x,
                weight: &weight,
                eps,
            };
            let [dx, dw, db] = norm.backward(&gradient);
            let found = [norm.forward(&bias), dx, dw, db];
            let expected = expected(&x, &weight, &bias, &gradient, eps);
            for (which, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let largest = expected
                    .iter()
                    .fold(1e-2f64, |most, value| most.max(value.abs()));
                for (found, expected) in found.iter().zip(expected) {
                    let error = (f64::from(*found) - expected).abs() / largest;
                    assert!(error < 2e-5, "{rows} {features} {which}: {error}");
                }
            }
        }
    }
}
