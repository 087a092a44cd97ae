//! The precision of matrix products.

use std::cell::Cell;

use burn::tensor::{FloatDType, Tensor};

use crate::mode::scoped;

/// The precision of a network's matrix products. Weights, normalizations, softmax and sums stay in
/// float32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32 bits: 23 of mantissa, 8 of exponent.
    #[default]
    Float32,
    /// 16 bits: 7 of mantissa, 8 of exponent. Factors, products and their gradients are rounded.
    /// The CPU kernels are float32 only and are not used.
    Bfloat16,
}

thread_local! {
    static CURRENT: Cell<Precision> = const { Cell::new(Precision::Float32) };
}

impl Precision {
    /// The precision of this thread's products.
    pub fn current() -> Self {
        CURRENT.get()
    }

    /// Runs `work` with this precision on this thread. A backward pass has the precision of its
    /// forward pass; a backward pass that recomputes parts of the forward pass must run inside the
    /// scope.
    pub fn scope<R>(self, work: impl FnOnce() -> R) -> R {
        scoped(&CURRENT, self, work)
    }
}

/// The matrix product `a b` in the current [`Precision`].
pub fn product<const D: usize>(a: Tensor<D>, b: Tensor<D>) -> Tensor<D> {
    match Precision::current() {
        Precision::Float32 => a.matmul(b),
        Precision::Bfloat16 => {
            let narrow = |x: Tensor<D>| x.cast(FloatDType::BF16);
            narrow(a).matmul(narrow(b)).cast(FloatDType::F32)
        }
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{DType, Device};

    use super::*;

    #[test]
    fn factors_lose_digits_and_gradients_come_back_in_float32() {
        let device = Device::flex().autodiff();
        // 1 + 2^-9 is 1 in bfloat16.
        let a = Tensor::<2>::from_data([[1.001_953_1, 2.0]], &device).require_grad();
        let b = Tensor::<2>::from_data([[3.0], [0.5]], &device);
        let value = |precision: Precision| {
            precision.scope(|| {
                let product = product(a.clone(), b.clone());
                assert_eq!(product.dtype(), DType::F32);
                let mut gradients = product.clone().sum().backward();
                let gradient = a.grad_remove(&mut gradients).expect("a gradient");
                assert_eq!(gradient.dtype(), DType::F32);
                let gradient = gradient.try_into_vec_as::<f32>().unwrap();
                (product.into_scalar::<f32>(), gradient)
            })
        };
        let (exact, gradient) = value(Precision::Float32);
        assert!((exact - 4.005_859).abs() < 1e-5, "{exact}");
        assert_eq!(gradient, [3.0, 0.5]);
        assert_eq!(value(Precision::Bfloat16), (4.0, vec![3.0, 0.5]));
        assert_eq!(Precision::current(), Precision::Float32);
    }
}
