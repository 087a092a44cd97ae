//! One steered step.

use burn::tensor::Tensor;

use super::{Guidance, Networks, Steering};
use crate::per_sample::per_sample;
use crate::sampler::Posterior;
use crate::{Clip, Denoiser, Error, GaussianDiffusion, PredictionType, guided};

/// Where a steered step begins.
#[derive(Clone, Debug)]
pub struct SteeredInput {
    /// The noisy motion: `[batch, channels, time]`, on the plain device.
    pub x_t: Tensor<3>,
    /// Where all samples are.
    pub timestep: usize,
    /// Where they go; `None` for the clean motion.
    pub prev_timestep: Option<usize>,
    /// Weight of the condition.
    pub guidance_scale: f64,
    /// The step's standard normal noise; none where it draws none.
    pub noise: Option<Tensor<3>>,
    /// Noise of the values put into a sample; none where no values are, or where the network
    /// predicts the clean motion.
    pub imputation_noise: Option<Tensor<3>>,
}

/// Where a steered step leads.
#[derive(Clone, Debug)]
pub struct SteeredOutput {
    /// The less noisy motion: `[batch, channels, time]`.
    pub prev_sample: Tensor<3>,
    /// The clean motion predicted on the way, clipped: that of the network where it predicts the
    /// clean motion, with the known values in it where it predicts noise.
    pub pred_original_sample: Tensor<3>,
    /// `s d(-L) / d x_t`, where the step was guided.
    pub scaled_gradient: Option<Tensor<3>>,
}

/// One DDPM step under steering (docs/sources.md, sections 4.6 to 4.8):
///
/// ```text
/// x_0    = clip(prediction at x_t)
/// g      = s d(-L(x_0)) / d x_t                       through clip and network
/// mean   = coef1 x_0 + coef2 x_t + variance g
/// ```
///
/// Where the network predicts the clean motion, known values go into x_0, and those entries of the
/// mean that they make replace the guided ones:
///
/// ```text
/// mean  <- known entries of (coef1 put(x_0) + coef2 x_t), else mean
/// ```
///
/// Where it predicts noise, they go into the sample, noised to the level it has landed on.
///
/// # Errors
/// If the clipping bounds do not fit the channels, or the network's output has other sizes than
/// its input.
pub fn steered_step<D: Denoiser<Cond = Tensor<3>> + ?Sized>(
    diffusion: &GaussianDiffusion,
    networks: Networks<'_, D>,
    input: SteeredInput,
    cond: &Tensor<3>,
    clip: &Clip,
    steering: &Steering<'_>,
) -> Result<SteeredOutput, Error> {
    let SteeredInput {
        x_t,
        timestep,
        prev_timestep,
        guidance_scale,
        noise,
        imputation_noise,
    } = input;
    let batch = x_t.dims()[0];
    let timesteps = vec![timestep; batch];
    let posterior = Posterior::of(diffusion, &timesteps, &vec![prev_timestep; batch]);
    let predict = |network: &D, x_t: Tensor<3>, cond: &Tensor<3>| {
        let output = guided(network, x_t.clone(), &timesteps, cond, guidance_scale);
        let (found, expected) = (output.dims(), x_t.dims());
        if found != expected {
            return Err(Error::ModelOutput {
                found: found.into(),
                expected: expected.into(),
            });
        }
        clip.apply(diffusion.pred_original_sample(output, x_t, &timesteps))
    };

    let (x_start, scaled_gradient) = match steering.guidance {
        Some(Guidance { goal, scale }) => {
            let tracked = x_t.clone().autodiff().require_grad();
            let prediction = predict(networks.tracked, tracked.clone(), &cond.clone().autodiff())?;
            let x_start = prediction.clone().without_autodiff();
            // The gradient of this sum with respect to x_t is that of the loss.
            let cotangent = goal.gradient(&x_start).autodiff();
            let mut gradients = (prediction * cotangent).sum().backward();
            let gradient = match tracked.grad_remove(&mut gradients) {
                Some(gradient) => gradient.without_autodiff(),
                None => x_t.zeros_like(),
            };
            (x_start, Some(gradient * -scale))
        }
        None => (predict(networks.plain, x_t.clone(), cond)?, None),
    };

    let by_mean = diffusion.config.prediction_type == PredictionType::Sample;
    let unguided = posterior.mean(x_start.clone(), x_t.clone());
    let guided_mean = scaled_gradient.as_ref().map(|gradient| {
        let variance = per_sample(&posterior.variance, &x_t);
        unguided.clone() + gradient.clone() * variance
    });
    let mean = match (&steering.imputation, by_mean) {
        (Some(imputation), true) => {
            let imputed = posterior.mean(imputation.put_into(x_start.clone()), x_t);
            match guided_mean {
                Some(guided) => imputation.merge(imputed, guided),
                // Outside the mask both means are the same: the map back and forth only rounds.
                None => imputed,
            }
        }
        _ => guided_mean.unwrap_or(unguided),
    };
    let sample = match noise {
        Some(noise) => mean + posterior.scaled(noise),
        None => mean,
    };
    let (Some(imputation), false) = (&steering.imputation, by_mean) else {
        return Ok(SteeredOutput {
            prev_sample: sample,
            pred_original_sample: x_start,
            scaled_gradient,
        });
    };
    let known = imputation.put_into(x_start);
    let noised = match imputation_noise {
        Some(noise) => {
            // The published program goes no lower than the least noisy timestep.
            let level = prev_timestep.unwrap_or(0);
            diffusion.add_noise(known.clone(), noise, &vec![level; batch])
        }
        None => known.clone(),
    };
    Ok(SteeredOutput {
        prev_sample: imputation.merge(noised, sample),
        pred_original_sample: known,
        scaled_gradient,
    })
}
