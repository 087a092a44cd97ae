//! Run-time choice of the instruction set, prefetching, and a vectorizable exponential.

use pulp::Arch;

/// Runs `work` compiled for the best instruction set of this processor.
///
/// Functions called by `work` must be inlined to be vectorized.
#[inline(always)]
pub(crate) fn vectorized<R>(work: impl FnOnce() -> R) -> R {
    Arch::new().dispatch(work)
}

/// Prefetches values. A product reads each weight once, in an order that the processor does not
/// predict.
#[inline(always)]
pub(crate) fn fetch(values: &[f32]) {
    /// Elements of a cache line.
    const CACHE_LINE: usize = 16;
    for line in values.chunks(CACHE_LINE) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the prefetch reads and writes nothing; every x86-64 has the instruction.
        #[allow(unsafe_code)]
        unsafe {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast());
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = line;
    }
}

/// `e^x` to within 2 units in the last place, without branches or calls, so that loops vectorize.
/// The result overflows to infinity, underflows gradually to zero and keeps NaN.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    /// Adding `ROUND` rounds to an integer in the low bits.
    const ROUND: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_145_75;
    const LN_2_LOW: f32 = 1.428_606_8e-6;
    let bounded = x.clamp(-104.0, 89.0);
    let rounded = bounded * std::f32::consts::LOG2_E + ROUND;
    let n = rounded.to_bits().wrapping_sub(ROUND.to_bits()) as i32;
    let k = rounded - ROUND;
    let r = bounded - k * LN_2_HIGH - k * LN_2_LOW;
    // Minimax polynomial of (e^r - 1 - r) / r^2 on [-ln 2 / 2, ln 2 / 2] (Cephes, expf).
    let p = 1.987_569_1e-4_f32;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let y = p * r * r + r + 1.0;
    // 2^n in two factors, because n exceeds the range of one exponent.
    let half = n >> 1;
    let power = |n: i32| f32::from_bits(((n + 127) as u32) << 23);
    let y = y * power(half) * power(n - half);
    if x.is_nan() { x } else { y }
}

/// `1 / (1 + e^-x)`.
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_right_to_two_units_in_the_last_place() {
        let mut largest = 0.0_f64;
        for i in -8_700_000..8_800_000 {
            let x = i as f32 * 1e-5;
            let exact = f64::from(x).exp();
            let ulp = f64::from(f32::EPSILON) * exact;
            largest = largest.max((f64::from(exp(x)) - exact).abs() / ulp);
        }
        assert!(largest < 2.0, "{largest} units in the last place");
    }

    #[test]
    fn exp_at_the_ends() {
        assert_eq!(exp(f32::INFINITY), f32::INFINITY);
        assert_eq!(exp(89.0), f32::INFINITY);
        assert_eq!(exp(f32::NEG_INFINITY), 0.0);
        assert_eq!(exp(-200.0), 0.0);
        assert!(exp(-100.0) > 0.0, "subnormal");
        assert!(exp(f32::NAN).is_nan());
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-0.0), 1.0);
    }
}
