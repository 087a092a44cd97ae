//! Autoregressive flow matching: a training step, and sampled poses. The inputs are
//!
//! ```text
//! history  [batch, 263, time]   cond   [batch, 512, 1]    place  [batch, 2, 1]: progress, duration
//! motion   [batch, 66, 1]       noise  [batch, 3, 22]     times  [batch, 1, 1]
//! ```

use burn::tensor::{Device, Tensor};
use kinegrad_data::TEXT;
use kinegrad_diffusion::{FlowPrediction, SamplerConfig, SamplerKind};
use kinegrad_flow::network::{FlowCondition, FlowModel, History, previous_state};
use kinegrad_flow::recipe::{FlowRandomInputs, FlowRecipe};
use kinegrad_flow::{HISTORY, PLACE, PoseConfig};
use kinegrad_models::Initializer;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_train::Loss;
use kinegrad_train::denoising::{Conditions, HeldOut, Inputs};

use crate::files::NamedTensors;
use crate::{Done, Network, Result, Work, count};

/// The networks of a row and their weights.
pub fn model(network: &Network, device: &Device) -> Result<FlowModel> {
    let Network::Flow(sizes) = network else {
        return Err("the task is one of motion that goes on".into());
    };
    let init = Initializer::new(0, device);
    Ok(sizes.init(&Skeleton::humanml3d(), &init)?)
}

/// The recipe and its loss for the inputs.
pub fn training(
    inputs: &NamedTensors,
) -> Result<(FlowRecipe, impl Fn(&FlowRecipe, &FlowModel) -> Loss + use<>)> {
    let x_start = inputs.tensor("motion")?;
    let [batch, ..] = x_start.dims();
    let windows = Inputs {
        mask: Tensor::ones([batch, 1], &x_start.device()),
        cond: Conditions::new([
            (HISTORY, inputs.tensor("history")?),
            (TEXT, inputs.tensor("cond")?),
            (PLACE, inputs.tensor("place")?),
        ]),
        lengths: None,
        x_start,
    };
    let times: Vec<f32> = inputs.tensor("times")?.try_into_vec_as()?;
    let draws = FlowRandomInputs {
        times: times.into_iter().map(f64::from).collect(),
        noise: inputs.tensor("noise")?,
        text_mask: None,
    };
    let recipe = FlowRecipe {
        pose: PoseConfig::default(),
        held_out: HeldOut::nothing(),
    };
    let loss = move |recipe: &FlowRecipe, model: &FlowModel| {
        recipe.loss_of(model, windows.clone(), draws.clone())
    };
    Ok((recipe, loss))
}

/// Histories, and the start noise of their next poses.
pub struct Drawing {
    model: FlowModel,
    sampler: SamplerConfig,
    /// History, text, place and noise of each.
    poses: Vec<[Tensor<3>; 4]>,
}

impl Drawing {
    pub fn new(model: FlowModel, inputs: &NamedTensors, steps: usize) -> Result<Self> {
        let all = ["history", "cond", "place", "noise"].map(|name| inputs.tensor(name));
        let [history, text, place, noise] = all;
        let all = [history?, text?, place?, noise?];
        let [batch, ..] = all[0].dims();
        let pose = |i: usize| all.clone().map(|tensor| tensor.narrow(0, i, 1));
        Ok(Self {
            model,
            sampler: SamplerConfig::new(SamplerKind::Euler, steps),
            poses: (0..batch).map(pose).collect(),
        })
    }
}

impl Work for Drawing {
    fn parameters(&self) -> usize {
        count(&self.model)
    }

    fn step(&mut self) -> Result<Done> {
        let mut drawn = Vec::with_capacity(self.poses.len());
        for [history, text, place, noise] in self.poses.clone() {
            let [_, channels, frames] = history.dims();
            let last = history.clone().narrow(2, frames - 1, 1);
            let cond = FlowCondition {
                context: self.model.encoder.forward(History {
                    frames: history,
                    lengths: vec![frames],
                    text: text.squeeze_dim(2),
                    duration: Some(place.clone().narrow(1, 1, 1).squeeze_dim(2)),
                }),
                null_context: None,
                previous: previous_state(last.reshape([1, channels])),
                progress: place.narrow(1, 0, 1).reshape([1]),
            };
            let flowed = self.model.predictor.sample(
                noise,
                &cond,
                FlowPrediction::Velocity,
                &self.sampler,
            )?;
            drawn.push(flowed.x.swap_dims(1, 2));
        }
        Ok(Done {
            sample: Some(Tensor::cat(drawn, 0)),
            ..Done::default()
        })
    }
}
