//! Flow matching of the next pose.
//!
//! ```text
//! x_t = (1 - t) noise + t x_start      t uniform in 0 to 1, x_start the next pose, normalised
//! L   = mean over samples, joints and coordinates of  (v_theta(x_t, t, context) - v)^2
//! ```
//!
//! with the target of `pose.prediction_type` instead of `v = x_start - noise` (docs/sources.md,
//! section 5).

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{Batch, TEXT};
use kinegrad_diffusion::FlowPrediction;
use kinegrad_random::Purpose;
use kinegrad_train::denoising::{HeldOut, Inputs, noise};
use kinegrad_train::{Loss, Measured, Recipe, StepKey};

use super::PoseConfig;
use super::windows::{HISTORY, PLACE};
use crate::network::{FlowCondition, FlowModel, History, previous_state};

/// Trains a [`FlowModel`].
pub struct FlowRecipe {
    /// Inputs and target of the prediction.
    pub pose: PoseConfig,
    /// The validation windows.
    pub held_out: HeldOut,
}

/// The random inputs of one batch's loss.
#[derive(Clone, Debug)]
pub struct FlowRandomInputs {
    /// Flow time of each sample.
    pub times: Vec<f64>,
    /// Standard normal: `[batch, 3, J]`.
    pub noise: Tensor<3>,
    /// 0 for dropped texts, else 1: `[batch, 1, 1]`. `None` drops no text.
    pub text_mask: Option<Tensor<3>>,
}

impl FlowRecipe {
    /// The loss of a batch of windows. `x_start` has the poses, `[batch, 3 J, 1]`, joint by joint;
    /// the conditions are [`HISTORY`], [`PLACE`] and `text`.
    ///
    /// # Panics
    /// If a condition is missing.
    pub fn loss_of(&self, model: &FlowModel, inputs: Inputs, draws: FlowRandomInputs) -> Loss {
        let Inputs { x_start, cond, .. } = inputs;
        let prediction_type = self.pose.prediction_type;
        let x_start = of_joints(x_start);
        let [batch, ..] = x_start.dims();
        let history = cond.get(HISTORY).clone();
        let mut text = cond.get(TEXT).clone();
        if let Some(mask) = draws.text_mask {
            text = text * mask;
        }
        let place = cond.get(PLACE).clone();
        let [_, channels, frames] = history.dims();
        let previous = history.clone().narrow(2, frames - 1, 1);
        let context = model.encoder.forward(History {
            frames: history.clone(),
            lengths: vec![frames; batch],
            text: model.text(text.squeeze_dim(2)),
            duration: Some(place.clone().narrow(1, 1, 1).reshape([batch, 1])),
        });
        let cond = FlowCondition {
            context: context.clone(),
            null_context: None,
            previous: previous_state(previous.reshape([batch, channels])),
            progress: place.narrow(1, 0, 1).reshape([batch]),
        };
        let x_t = FlowPrediction::add_noise(draws.noise.clone(), x_start.clone(), &draws.times);
        let target = prediction_type.target(draws.noise, x_start.clone());
        let times: Vec<f32> = draws.times.iter().map(|&t| t as f32).collect();
        let times = Tensor::from_data(TensorData::new(times, [batch]), &x_t.device());
        let model_output = model.predictor.forward(x_t.clone(), times, &cond);
        let total = (model_output.clone() - target).powi_scalar(2).mean();
        Loss {
            terms: vec![("flow", total.clone())],
            probes: vec![
                ("history", history),
                ("context", context),
                ("x_start", x_start),
                ("x_t", x_t),
                ("model_output", model_output),
            ],
            total,
            pending: (),
        }
    }
}

/// Poses `[batch, 3 J, 1]`, joint by joint, as `[batch, 3, J]`.
fn of_joints(poses: Tensor<3>) -> Tensor<3> {
    let [batch, numbers, _] = poses.dims();
    poses.reshape([batch, numbers / 3, 3]).swap_dims(1, 2)
}

impl Recipe for FlowRecipe {
    type Model = FlowModel;
    type Pending = ();

    fn loss(&self, model: &FlowModel, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let size = batch.batch_size;
        let probability = self.pose.cond_drop_prob;
        let text_mask = (probability > 0.0).then(|| {
            let uniforms = key.of(Purpose::CondDropout).uniforms(size).into_iter();
            let mask = uniforms.map(|u| f32::from(f64::from(u) >= probability));
            Tensor::from_data(TensorData::new(mask.collect(), [size, 1, 1]), device)
        });
        let [_, numbers, _] = inputs.x_start.dims();
        let times = key.of(Purpose::Timesteps).uniforms(size).into_iter();
        let draws = FlowRandomInputs {
            times: times.map(f64::from).collect(),
            noise: noise(key.of(Purpose::Noise), [size, 3, numbers / 3], device),
            text_mask,
        };
        self.loss_of(model, inputs, draws)
    }

    /// Flow times are evenly spread over items and repeats.
    fn validation_loss(&self, model: &FlowModel, device: &Device) -> Measured {
        let (all, repeats) = (self.held_out.len(), self.held_out.draws());
        let total = self.held_out.mean(device, |repeat, range, inputs| {
            let time = |p| ((repeat * all + p) as f64 + 0.5) / (repeats * all) as f64;
            let like = of_joints(inputs.x_start.clone());
            let draws = FlowRandomInputs {
                times: range.clone().map(time).collect(),
                noise: self.held_out.noise(range, repeat as u64, &like),
                text_mask: None,
            };
            self.loss_of(model, inputs, draws).total
        });
        Measured {
            total,
            terms: Vec::new(),
        }
    }
}
