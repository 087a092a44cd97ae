use super::simd::{exp, sigmoid};

/// Activation after a normalization.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activation {
    /// The identity.
    #[default]
    None,
    /// `x sigmoid(x)`.
    Silu,
    /// `x tanh(ln(1 + e^x))`.
    Mish,
}

/// An [`Activation`] as a type, so that loops are specialized for each activation.
pub(crate) trait Pointwise: Copy + Send + Sync {
    fn value(self, x: f32) -> f32;
    fn derivative(self, x: f32) -> f32;
}

#[derive(Clone, Copy)]
pub(crate) struct Identity;
#[derive(Clone, Copy)]
pub(crate) struct Silu;
#[derive(Clone, Copy)]
pub(crate) struct Mish;

impl Pointwise for Identity {
    #[inline(always)]
    fn value(self, x: f32) -> f32 {
        x
    }

    #[inline(always)]
    fn derivative(self, _: f32) -> f32 {
        1.0
    }
}

impl Pointwise for Silu {
    #[inline(always)]
    fn value(self, x: f32) -> f32 {
        x * sigmoid(x)
    }

    #[inline(always)]
    fn derivative(self, x: f32) -> f32 {
        let s = sigmoid(x);
        s * (1.0 + x * (1.0 - s))
    }
}

impl Mish {
    /// `tanh(ln(1 + e^x)) = e (e + 2) / (e (e + 2) + 2)` with `e = e^x`; 1 in single precision for
    /// x >= 20.
    #[inline(always)]
    fn gate(x: f32) -> f32 {
        let e = exp(if x > 20.0 { 20.0 } else { x });
        let square = e * (e + 2.0);
        square / (square + 2.0)
    }
}

impl Pointwise for Mish {
    #[inline(always)]
    fn value(self, x: f32) -> f32 {
        x * Self::gate(x)
    }

    #[inline(always)]
    fn derivative(self, x: f32) -> f32 {
        let gate = Self::gate(x);
        gate + x * (1.0 - gate * gate) * sigmoid(x)
    }
}

/// Evaluates `$body` with `$activation` as the [`Pointwise`] of an [`Activation`].
macro_rules! with_activation {
    ($kind:expr, |$activation:ident| $body:expr) => {
        match $kind {
            $crate::host::activation::Activation::None => {
                let $activation = $crate::host::activation::Identity;
                $body
            }
            $crate::host::activation::Activation::Silu => {
                let $activation = $crate::host::activation::Silu;
                $body
            }
            $crate::host::activation::Activation::Mish => {
                let $activation = $crate::host::activation::Mish;
                $body
            }
        }
    };
}
pub(crate) use with_activation;
