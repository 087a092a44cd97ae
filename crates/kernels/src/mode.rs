//! The switch between kernels and composed operations.

use std::cell::Cell;
use std::sync::OnceLock;
use std::thread::LocalKey;

use burn::backend::DispatchTensorKind;
use burn::tensor::{DType, Tensor};

use crate::precision::Precision;

/// The environment variable that sets the [`Mode`].
pub const VARIABLE: &str = "KINEGRAD_KERNELS";

/// Execution of operations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Kernels where they exist (on the CPU).
    #[default]
    Fused,
    /// Burn's operations everywhere.
    Composed,
}

/// The environment variable has an unknown value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModeError {
    /// Its value.
    pub found: String,
}

thread_local! {
    static OVERRIDE: Cell<Option<Mode>> = const { Cell::new(None) };
}

impl Mode {
    /// The mode of the environment variable; fused by default.
    ///
    /// # Errors
    /// If its value is unknown.
    pub fn from_environment() -> Result<Self, ModeError> {
        let Some(found) = std::env::var_os(VARIABLE) else {
            return Ok(Self::default());
        };
        match found.to_str() {
            Some("fused") => Ok(Self::Fused),
            Some("composed") => Ok(Self::Composed),
            _ => Err(ModeError {
                found: found.to_string_lossy().into_owned(),
            }),
        }
    }

    /// The mode of this thread: that of the enclosing [`scope`](Self::scope), otherwise the
    /// environment's mode at first use.
    pub fn current() -> Self {
        static ENVIRONMENT: OnceLock<Mode> = OnceLock::new();
        let environment =
            || *ENVIRONMENT.get_or_init(|| Self::from_environment().unwrap_or_default());
        OVERRIDE.get().unwrap_or_else(environment)
    }

    /// Runs `work` with this mode on this thread.
    pub fn scope<R>(self, work: impl FnOnce() -> R) -> R {
        scoped(&OVERRIDE, Some(self), work)
    }
}

/// Runs `work` with `cell` set to `value` on this thread.
pub(crate) fn scoped<T: Copy, R>(
    cell: &'static LocalKey<Cell<T>>,
    value: T,
    work: impl FnOnce() -> R,
) -> R {
    struct Restore<T: Copy + 'static>(&'static LocalKey<Cell<T>>, T);
    impl<T: Copy> Drop for Restore<T> {
        fn drop(&mut self) {
            self.0.set(self.1);
        }
    }
    let _restore = Restore(cell, cell.replace(value));
    work()
}

/// True if operations on this tensor run as kernels.
pub(crate) fn fuses<const D: usize>(x: &Tensor<D>) -> bool {
    fn on_flex(kind: &DispatchTensorKind) -> bool {
        match kind {
            DispatchTensorKind::Flex(_) => true,
            DispatchTensorKind::Autodiff(inner) => on_flex(inner),
            // Unreachable if Flex is the only backend.
            #[allow(unreachable_patterns)]
            _ => false,
        }
    }
    Mode::current() == Mode::Fused
        && Precision::current() == Precision::Float32
        && x.dtype() == DType::F32
        && on_flex(&x.clone().into_dispatch().kind)
}
