//! The callback of a sampler's steps.

use std::ops::ControlFlow;

use burn::tensor::Tensor;

use crate::Error;

/// Callback after each step: the number of steps done, starting from 1, the total number of steps,
/// and the new state `[batch, channels, time]`. `Break` ends the sampler with [`Error::Stopped`].
pub type OnStep<'a> = dyn FnMut(usize, usize, &Tensor<3>) -> ControlFlow<()> + 'a;

/// The error of a sampler whose callback asked it to stop.
pub(crate) fn go_on(flow: ControlFlow<()>) -> Result<(), Error> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Stopped),
    }
}
