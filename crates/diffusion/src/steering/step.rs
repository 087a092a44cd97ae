//! One steered step.

use burn::tensor::Tensor;

use super::{Guidance, Networks, Steering};
use crate::per_sample::per_sample;
use crate::sampler::{Posterior, StepOutput};
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

/// One DDPM step under steering (golden README of GMD, sections 2.2 to 2.4):
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
/// The prediction that is returned is that of the network for the former, and holds the known
/// values for the latter.
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
) -> Result<StepOutput, Error> {
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

    let (x_start, shift) = match steering.guidance {
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
            let factors: Vec<f64> = posterior.variance.iter().map(|v| -scale * v).collect();
            let shift = gradient * per_sample(&factors, &x_t);
            (x_start, Some(shift))
        }
        None => (predict(networks.plain, x_t.clone(), cond)?, None),
    };

    let by_mean = diffusion.config.prediction_type == PredictionType::Sample;
    let guided_mean = |x_start: Tensor<3>, x_t: Tensor<3>, shift: Option<Tensor<3>>| {
        let mean = posterior.mean(x_start, x_t);
        match shift {
            Some(shift) => mean + shift,
            None => mean,
        }
    };
    let mean = match (&steering.imputation, by_mean) {
        (Some(imputation), true) => {
            let imputed = imputation.put_into(x_start.clone());
            let imputed = posterior.mean(imputed, x_t.clone());
            match shift {
                // Outside the mask both means are the same: the map back and forth only rounds.
                None => imputed,
                shift => imputation.merge(imputed, guided_mean(x_start.clone(), x_t, shift)),
            }
        }
        _ => guided_mean(x_start.clone(), x_t, shift),
    };
    let sample = match noise {
        Some(noise) => mean + posterior.scaled(noise),
        None => mean,
    };
    let (Some(imputation), false) = (&steering.imputation, by_mean) else {
        return Ok(StepOutput {
            prev_sample: sample,
            pred_original_sample: x_start,
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
    Ok(StepOutput {
        prev_sample: imputation.merge(noised, sample),
        pred_original_sample: known,
    })
}
