//! The cases of golden file 07_e2e as inputs of the recipe `e2e`.

use std::sync::Arc;

use burn::tensor::{Device, Tensor};
use kinegrad_cc_motion::network::MotionModel;
use kinegrad_cc_motion::recipes::{E2eRandomInputs, E2eRecipe, Rollouts};
use kinegrad_cc_motion::{LossConfig, RolloutConfig, RolloutMode, RolloutStart};
use kinegrad_data::AUDIO;
use kinegrad_diffusion::{BetaSchedule, DiffusionConfig, GaussianDiffusion, PredictionType};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_motion::Statistics;
use kinegrad_train::config::ClipSample;
use kinegrad_train::denoising::{Conditions, HeldOut, Inputs, RandomInputs};

use crate::golden::{Golden, GoldenTensors, Reference};
use crate::{decoder, unet, weights};

/// A case of golden file 07_e2e.
pub struct Case {
    /// The file.
    pub golden: Golden,
    /// Name of the case.
    pub name: &'static str,
    /// An autodiff device.
    pub device: Device,
    /// The case's process.
    pub diffusion: GaussianDiffusion,
}

impl Case {
    /// The case `name` of the file.
    ///
    /// # Panics Panics if there is no case of that name.
    pub fn of(golden: Golden, name: &'static str) -> Self {
        let (schedule, timesteps) = match name {
            "linear50" => (BetaSchedule::Linear, 50),
            "linear1000" => (BetaSchedule::Linear, 1000),
            "cosine1000" => (BetaSchedule::Cosine, 1000),
            other => panic!("case {other}"),
        };
        let config = DiffusionConfig {
            num_train_timesteps: timesteps,
            beta_schedule: schedule,
            prediction_type: PredictionType::Epsilon,
            ..DiffusionConfig::default()
        };
        Self {
            golden,
            name,
            device: Device::flex().autodiff(),
            diffusion: GaussianDiffusion::new(&config).expect("a valid process"),
        }
    }

    /// Both networks, with the file's weights.
    pub fn model(&self) -> MotionModel {
        let init = Initializer::new(0, &self.device);
        let sizes: serde_json::Value =
            serde_json::from_str(self.golden.metadata("decoder")).expect("JSON");
        let size = |key: &str| sizes[key].as_u64().expect("a number") as usize;
        let model = MotionModel {
            unet: unet::fresh(self.golden.metadata("unet"), &init),
            decoder: decoder::of_size(size("hidden"), size("layers"), &self.device),
        };
        parameters::load(model, weights(&self.golden, "model.")).expect("the weights fit")
    }

    /// A tensor of the file.
    pub fn tensor(&self, name: &str) -> Tensor<3> {
        self.golden.tensor(name, &self.device)
    }

    /// Ground truth, condition and a mask of ones.
    pub fn inputs(&self) -> Inputs {
        let x_start = self.tensor("in.gt");
        let [batch, _, time] = x_start.dims();
        Inputs {
            x_start,
            cond: Conditions::new([(AUDIO, self.tensor("in.cond"))]),
            mask: Tensor::ones([batch, time], &self.device),
            lengths: None,
        }
    }

    /// The recipe with CC-MotionGen's settings.
    pub fn recipe(&self, mode: RolloutMode) -> E2eRecipe {
        let statistics = Arc::new(Statistics::unit(25));
        let last = self.diffusion.config.num_train_timesteps - 1;
        let config = RolloutConfig {
            steps: self.steps(),
            mode,
            last_k: 1,
            start: RolloutStart::Noise,
            start_timesteps: [last, last],
            clip: ClipSample::None,
            clip_range: None,
            straight_through: false,
            gradient_decay: 1.0,
            guidance_scale: 1.0,
            style_guidance_scale: None,
        };
        let sampler = Rollouts::new(self.diffusion.clone(), &config, statistics);
        let sampler = sampler.expect("nothing is clipped");
        E2eRecipe::new(sampler, &LossConfig::ccmotion(), HeldOut::nothing())
    }

    /// DDIM steps.
    pub fn steps(&self) -> usize {
        let steps = self.golden.metadata("ddim_steps");
        steps.parse().expect("a number of steps")
    }

    /// The last timestep, for each sample.
    pub fn starts(&self) -> Vec<usize> {
        let batch = self.golden.get("in.x_T").shape[0];
        vec![self.diffusion.config.num_train_timesteps - 1; batch]
    }

    /// The file's values in place of random numbers.
    pub fn draws(&self) -> E2eRandomInputs {
        let timesteps = self.golden.get(&format!("in.{}.t", self.name));
        E2eRandomInputs {
            denoising: RandomInputs {
                timesteps: timesteps.indices(),
                noise: self.tensor("in.noise"),
                condition_dropout_mask: None,
                style_dropout_mask: None,
                dropout: None,
            },
            starts: self.starts(),
            start_noise: self.tensor("in.x_T"),
            decoder_dropout: None,
        }
    }

    /// The result `name` of the case.
    pub fn out(&self, name: &str) -> Reference {
        self.golden.reference(&format!("out.{}.{name}", self.name))
    }

    /// Tolerance of the decoder's gradients.
    pub fn decoder_tolerance(&self) -> f64 {
        if self.name == "cosine1000" {
            5e-3
        } else {
            2e-4
        }
    }

    /// Tolerance of the gradient of a parameter.
    pub fn tolerance(&self, parameter: &str) -> f64 {
        match parameter.starts_with("decoder.") {
            true => self.decoder_tolerance(),
            false => 2e-4,
        }
    }
}
