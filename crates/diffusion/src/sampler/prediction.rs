//! Predictions of the clean motion at a noise level.

use burn::tensor::Tensor;

use super::clip::ClipRange;
use super::steered::Steered;
use crate::error::check_output;
use crate::{Error, GaussianDiffusion, PredictionType, Time};

/// Predicts the clean motion from a noisy one, `[batch, channels, time]`, at [`Time`]s per sample.
///
/// Guidance, clipping, steering and rollouts act in this function.
pub type Predict<'p, 's> = dyn FnMut(Tensor<3>, &[Time]) -> Result<Prediction<'s>, Error> + 'p;

/// A prediction of the clean motion at a noise level.
pub struct Prediction<'s> {
    /// The input of the prediction, possibly with a different gradient. The step continues from
    /// this state.
    pub x_t: Tensor<3>,
    /// The predicted clean motion, clipped.
    pub x_start: Tensor<3>,
    /// The output of the network, after guidance.
    pub model_output: Tensor<3>,
    /// True if `x_start` was clipped.
    pub clipped: bool,
    /// Guidance and imputation of the step.
    pub steered: Option<Steered<'s>>,
}

impl<'s> Prediction<'s> {
    /// Converts `model_output` for `x_t`, by the process's prediction type.
    ///
    /// # Errors
    /// Fails if the sizes of the network's output and input differ, or the bounds do not fit the
    /// channels.
    pub fn new(
        diffusion: &GaussianDiffusion,
        model_output: Tensor<3>,
        x_t: Tensor<3>,
        timesteps: &[usize],
        clip: &ClipRange,
    ) -> Result<Self, Error> {
        check_output(&model_output, &x_t)?;
        let x_start = diffusion.pred_original_sample(model_output.clone(), x_t.clone(), timesteps);
        Ok(Self {
            x_start: clip.apply(x_start)?,
            clipped: *clip != ClipRange::None,
            x_t,
            model_output,
            steered: None,
        })
    }

    /// The predicted noise. With `recompute`, noise of a clipped prediction is recomputed from the
    /// clipped motion.
    pub fn epsilon(
        &self,
        diffusion: &GaussianDiffusion,
        timesteps: &[usize],
        recompute: bool,
    ) -> Tensor<3> {
        let (prediction, from) = match recompute && self.clipped {
            true => (&self.x_start, PredictionType::Sample),
            false => (&self.model_output, diffusion.config.prediction_type),
        };
        let (prediction, x_t) = (prediction.clone(), self.x_t.clone());
        diffusion.convert(prediction, x_t, timesteps, from, PredictionType::Epsilon)
    }
}
