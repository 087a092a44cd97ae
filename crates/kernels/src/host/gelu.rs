use super::simd::{exp, vectorized};
use super::team;

/// Elements of a task.
const CHUNK: usize = 1 << 13;

/// `erf(x)` to within 4e-7: a rational function on [-4, 4], and the sign of x elsewhere.
#[inline(always)]
fn erf(x: f32) -> f32 {
    let x = if x.is_nan() { x } else { x.clamp(-4.0, 4.0) };
    let square = x * x;
    let p = -2.726_142e-10_f32;
    let p = p * square + 2.770_681_4e-8;
    let p = p * square - 2.101_024e-6;
    let p = p * square - 5.692_506_4e-5;
    let p = p * square - 7.349_906e-4;
    let p = p * square - 2.954_6e-3;
    let p = p * square - 1.609_603_3e-2;
    let q = -1.456_607_2e-5_f32;
    let q = q * square - 2.133_740_6e-4;
    let q = q * square - 1.682_827e-3;
    let q = q * square - 7.373_329e-3;
    let q = q * square - 1.426_474e-2;
    if square < 16.0 { x * p / q } else { x / 4.0 }
}

/// `(1 + erf(x / sqrt 2)) / 2`.
#[inline(always)]
fn gate(x: f32) -> f32 {
    0.5 + 0.5 * erf(x * std::f32::consts::FRAC_1_SQRT_2)
}

/// `x (1 + erf(x / sqrt 2)) / 2` of each element.
pub(crate) fn forward(x: &[f32]) -> Vec<f32> {
    let mut y = vec![0.0; x.len()];
    let chunks = y.chunks_mut(CHUNK).zip(x.chunks(CHUNK)).collect();
    team::for_each_item(chunks, |(y, x): (&mut [f32], &[f32])| {
        vectorized(
            #[inline(always)]
            || {
                for (y, x) in y.iter_mut().zip(x) {
                    *y = x * gate(*x);
                }
            },
        );
    });
    y
}

/// The gradient of `x`.
pub(crate) fn backward(x: &[f32], gradient: &[f32]) -> Vec<f32> {
    /// `1 / sqrt(2 pi)`.
    const DENSITY: f32 = 0.398_942_3;
    let mut dx = vec![0.0; x.len()];
    let inputs = x.chunks(CHUNK).zip(gradient.chunks(CHUNK));
    let chunks = dx.chunks_mut(CHUNK).zip(inputs).collect();
    team::for_each_item(
        chunks,
        |(dx, (x, gradient)): (&mut [f32], (&[f32], &[f32]))| {
            vectorized(
                #[inline(always)]
                || {
                    for ((dx, x), gradient) in dx.iter_mut().zip(x).zip(gradient) {
                        *dx = gradient * (gate(*x) + x * DENSITY * exp(-0.5 * x * x));
                    }
                },
            );
        },
    );
    dx
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_far_from_0_pass_or_become_0() {
        let x = [-1e30, -40.0, -6.0, 6.0, 1e30];
        assert_eq!(forward(&x), [0.0, 0.0, 0.0, 6.0, 1e30]);
        assert_eq!(backward(&x, &[1.0; 5])[..2], [0.0; 2]);
        assert_eq!(backward(&x, &[1.0; 5])[4], 1.0);
        assert!(forward(&[f32::NAN])[0].is_nan());
    }
}
