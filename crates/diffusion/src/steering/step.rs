//! The prediction of a steered step.

use burn::tensor::Tensor;

use super::{Networks, Steering};
use crate::{
    ClipRange, Denoiser, Error, GaussianDiffusion, GuidanceScales, Prediction, Steered, Time,
    guided,
};

/// The prediction for `x_t` with the guidance and imputation of its step. The gradient of the
/// guidance is `g = s d(-L(x_0)) / d x_t`, through clipping and network.
///
/// # Shapes
/// - x_t: `[batch, channels, time]`, on the plain device
///
/// # Errors
/// Fails if the clipping bounds do not fit the channels, or the sizes of the network's output and
/// input differ.
#[expect(
    clippy::too_many_arguments,
    reason = "each is another thing, named at the call"
)]
pub fn steered_prediction<'s, D: Denoiser<Cond = Tensor<3>> + ?Sized>(
    diffusion: &GaussianDiffusion,
    networks: &Networks<'_, D>,
    x_t: Tensor<3>,
    time: &[Time],
    cond: &Tensor<3>,
    scales: GuidanceScales,
    clip: &ClipRange,
    steering: Steering<'s>,
) -> Result<Prediction<'s>, Error> {
    let timesteps = Time::timesteps(time);
    let predict = |network: &D, x_t: Tensor<3>, cond: &Tensor<3>| {
        let output = guided(network, x_t.clone(), time, cond, scales);
        Prediction::new(diffusion, output, x_t, &timesteps, clip)
    };
    let mut steered = Steered {
        scaled_gradient: None,
        max_shift: None,
        imputation: steering.imputation,
    };
    let Some(guidance) = steering.guidance else {
        return Ok(Prediction {
            steered: Some(steered),
            ..predict(networks.plain, x_t, cond)?
        });
    };
    let tracked = x_t.clone().autodiff().require_grad();
    let prediction = predict(networks.tracked, tracked.clone(), &cond.clone().autodiff())?;
    let x_start = prediction.x_start.clone().without_autodiff();
    // The gradient of this sum with respect to x_t is the gradient of the loss.
    let cotangent = guidance.objective.gradient(&x_start).autodiff();
    let mut gradients = (prediction.x_start * cotangent).sum().backward();
    let gradient = match tracked.grad_remove(&mut gradients) {
        Some(gradient) => gradient.without_autodiff(),
        None => x_t.zeros_like(),
    };
    steered.scaled_gradient = Some(gradient * -guidance.scale);
    steered.max_shift = guidance.max_shift;
    Ok(Prediction {
        x_t,
        x_start,
        model_output: prediction.model_output.without_autodiff(),
        clipped: prediction.clipped,
        steered: Some(steered),
    })
}
