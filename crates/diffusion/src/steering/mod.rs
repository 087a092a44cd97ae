//! Position control by classifier guidance and imputation of known values. The guidance is the
//! gradient of a loss of the predicted clean motion through the network.
//!
//! Source: Guided Motion Diffusion, appendix F, and Dhariwal and Nichol 2021,
//! <https://arxiv.org/abs/2105.05233>, algorithm 1. The shift of the mean is scaled by the
//! variance.

mod step;

use burn::tensor::Tensor;
use kinegrad_settings::{Refused, require};

pub use step::steered_prediction;

use crate::{
    ClipRange, Denoiser, Error, GaussianDiffusion, Imputation, NoiseKeys, OnStep, SamplerConfig,
    SamplerKind, Time, sample_with,
};

/// A loss of the clean motion.
pub trait Objective {
    /// The gradient of the loss with respect to the predicted clean motion.
    ///
    /// # Shapes
    /// - pred_original_sample, output: `[batch, channels, time]`, in network space on a plain
    ///   device
    fn gradient(&self, pred_original_sample: &Tensor<3>) -> Tensor<3>;
}

/// Guidance towards a goal.
#[derive(Clone, Copy)]
pub struct Guidance<'a> {
    /// The loss.
    pub objective: &'a dyn Objective,
    /// The guidance scale `s`. The variance of the step also multiplies the gradient.
    pub scale: f64,
    /// Largest norm of a frame's shift in one step, in standard deviations of the step's noise.
    pub max_shift: Option<f64>,
}

/// Guidance and imputation of one step.
#[derive(Clone, Default)]
pub struct Steering<'a> {
    /// Shifts the mean.
    pub guidance: Option<Guidance<'a>>,
    /// The known values to impute.
    pub imputation: Option<Imputation<'a>>,
}

/// A network with and without gradients.
#[derive(Debug)]
pub struct Networks<'a, D: ?Sized> {
    /// The network on an autodiff device; weights need no gradients.
    pub tracked: &'a D,
    /// The network on the plain device.
    pub plain: &'a D,
}

/// Generates one motion per sample of the start noise with DDPM, with the guidance and imputation
/// that `steering` returns for each timestep.
///
/// The noise is that of [`sample`](crate::sample). Imputation noise has the name `imputation`.
///
/// # Shapes
/// - x_T, the start noise, standard normal: `[batch, channels, time]`, on the plain device
/// - cond: the denoiser's condition for the batch, on the plain device
/// - output: `[batch, channels, time]`
///
/// # Errors
/// The errors of [`sample`](crate::sample), and an error for samplers other than DDPM.
#[expect(
    non_snake_case,
    reason = "x_T is the field's symbol for the start noise"
)]
#[expect(
    clippy::too_many_arguments,
    reason = "each is another thing, named at the call"
)]
pub fn steered_sample<'s, D: Denoiser<Cond = Tensor<3>> + ?Sized>(
    diffusion: &GaussianDiffusion,
    networks: &Networks<'_, D>,
    x_T: Tensor<3>,
    cond: &Tensor<3>,
    config: &SamplerConfig,
    clip: &ClipRange,
    steering: &dyn Fn(usize) -> Steering<'s>,
    keys: impl Into<NoiseKeys<'s>>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    require(
        matches!(config.kind, SamplerKind::Ddpm(_)),
        "sampling.sampler.kind",
        format!("\"{}\"", config.kind),
        "\"ddpm\" when sampling with a goal",
    )
    .hint("guidance is scaled by the variance of the step, which only DDPM has")?;
    clip.validate(x_T.dims()[1])?;
    let mut predict = |x: Tensor<3>, time: &[Time]| {
        let steering = steering(time[0].timestep());
        let scales = config.guidance(time[0].timestep());
        steered_prediction(diffusion, networks, x, time, cond, scales, clip, steering)
    };
    sample_with(diffusion, &mut predict, x_T, config, keys.into(), on_step)
}
