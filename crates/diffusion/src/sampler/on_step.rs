//! The callback of a sampler's steps.

use std::ops::ControlFlow;

use burn::tensor::Tensor;

use crate::Error;

/// Callback after each step: the number of steps done, starting from 1, the total number of steps,
/// and the new state `[batch, channels, time]`. `Break` ends the sampler with [`Error::Stopped`].
pub type OnStep<'a> = dyn FnMut(usize, usize, &Tensor<3>) -> ControlFlow<()> + 'a;

/// # Errors
/// [`Error::Stopped`] if the callback returned `Break`.
pub(crate) fn continue_or_stop(flow: ControlFlow<()>) -> Result<(), Error> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Stopped),
    }
}
