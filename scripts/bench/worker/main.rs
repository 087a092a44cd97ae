//! kinegrad's worker of `scripts/bench/run`: runs one step per request.
//!
//! ```text
//! bench_worker FOLDER DEVICE
//!
//! FOLDER/row.json             what a step is: the type `Row` below
//! FOLDER/inputs.safetensors   motion, cond, noise, timesteps, x_T; those of flow.rs and matching.rs
//! ```
//!
//! It answers each line of its input with one line of JSON, and prints one after loading:
//!
//! ```text
//!             {"parameters", "start_kib"}
//! step        {"seconds", "loss", "peak_kib"}; no loss where nothing is trained
//! save PATH   {}: the last sample is in PATH, little-endian float32
//! ```

mod files;
mod flow;
mod matching;

use std::error::Error;
use std::fs;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_cc_motion::network::DecoderConfig;
use kinegrad_cc_motion::network::MotionModel;
use kinegrad_cc_motion::network::UNet1d;
use kinegrad_cc_motion::network::UNet1dConfig;
use kinegrad_cc_motion::network::decoder::{DecoderInit, Normalization};
use kinegrad_cc_motion::recipes::{E2eRandomInputs, E2eRecipe, Rollouts, diffusion_recipe};
use kinegrad_cc_motion::{LossConfig, RolloutConfig};
use kinegrad_data::AUDIO_CHANNELS;
use kinegrad_diffusion::{
    ClipRange, DiffusionConfig, GaussianDiffusion, PredictionType, SamplerConfig, sample,
};
use kinegrad_flow::network::FlowConfig;
use kinegrad_gmd::network::Backbone;
use kinegrad_gmd::network::GmdUnetConfig;
use kinegrad_gmd::network::TextDenoiser;
use kinegrad_gmd::recipes::clip_recipe;
use kinegrad_gmd::{GmdConfig, GmdLossConfig};
use kinegrad_models::Initializer;
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_motion::Statistics;
use kinegrad_motion::phrase::CHANNELS;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::config::{EmaConfig, OptimConfig};
use kinegrad_train::denoising::{DenoisingRecipe, HeldOut};
use kinegrad_train::optim::{AdamW, Moments, clip_factor, norm_of_squares, squares};
use kinegrad_train::{Loss, Recipe};
use serde::Deserialize;
use serde_json::json;

use files::{NamedTensors, read_weights};
use matching::{Example, Matching};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// A row of the benchmark.
#[derive(Deserialize)]
struct Row {
    /// File of weights by state-dict name.
    weights: PathBuf,
    model: Network,
    prediction_type: PredictionType,
    task: Task,
}

/// The network of a step.
#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Network {
    /// A denoiser of Guided Motion Diffusion.
    GmdUnet(Gmd),
    /// An audio-conditioned denoiser.
    Unet1d(UNet1dConfig),
    /// Autoregressive flow matching.
    Flow(FlowConfig),
    /// No network: patches of an example are matched.
    Matching(Example),
}

/// The sizes of a network of Guided Motion Diffusion.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Gmd {
    motion_channels: usize,
    model_channels: usize,
    channel_mult: Vec<f64>,
    padded_frames: usize,
}

impl Gmd {
    fn init(&self, device: &Device) -> Result<TextDenoiser> {
        let backbone = Backbone::GmdUnet(GmdUnetConfig {
            latent_dim: self.model_channels,
            dim_mults: self.channel_mult.clone(),
            padded_frames: self.padded_frames,
            ..GmdUnetConfig::default()
        });
        let init = Initializer::new(0, device);
        Ok(TextDenoiser::new(&backbone, self.motion_channels, &init)?)
    }
}

/// The work of a step.
#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Task {
    /// Trains the denoiser on noised motion.
    Train {
        optim: OptimConfig,
        max_grad_norm: f64,
    },
    /// Trains denoiser and decoder through the sampler.
    EndToEnd {
        optim: OptimConfig,
        max_grad_norm: f64,
        rollout: RolloutConfig,
    },
    /// Trains a network of Guided Motion Diffusion on noised clips and updates its moving average.
    TrainGmd {
        diffusion: DiffusionConfig,
        trajectory_scale: f64,
        optim: OptimConfig,
        max_grad_norm: f64,
        ema: EmaConfig,
    },
    /// Trains the networks of autoregressive flow matching.
    TrainFlow {
        optim: OptimConfig,
        max_grad_norm: f64,
        ema: EmaConfig,
    },
    /// Samples the next poses of histories, one after the other.
    DrawFlow { steps: usize },
    /// Samples one batch of motion.
    Sample { sampler: SamplerConfig },
    /// Synthesises a motion from an example, with the settings of GenMM's published program.
    Match,
}

/// A task with its networks.
trait Work {
    /// Number of elements of all parameters.
    fn parameters(&self) -> usize;

    /// One step.
    fn step(&mut self) -> Result<Done>;
}

/// The result of a step.
#[derive(Default)]
struct Done {
    loss: Option<f32>,
    sample: Option<Tensor<3>>,
}

type LossOf<R> = Box<dyn Fn(&R, &<R as Recipe>::Model) -> Loss<<R as Recipe>::Pending>>;

/// The updates of [`kinegrad_train::Trainer`] on a constant batch.
struct Training<R: Recipe> {
    recipe: R,
    /// `None` only during an update.
    model: Option<R::Model>,
    loss: LossOf<R>,
    optimizer: AdamW,
    moments: Vec<Moments>,
    /// Learning rate of each parameter.
    rates: Vec<f64>,
    max_grad_norm: f64,
    /// The moving average, if the row has one.
    ema: Option<(EmaConfig, Vec<Vec<f32>>)>,
}

impl<R: Recipe> Training<R> {
    fn new(
        recipe: R,
        model: R::Model,
        optim: &OptimConfig,
        max_grad_norm: f64,
        loss: impl Fn(&R, &R::Model) -> Loss<R::Pending> + 'static,
    ) -> Self {
        let infos = parameters::infos(&model);
        let rate = |info: &ParameterInfo| {
            let group = ["unet", "decoder"][recipe.group_of(&info.name)];
            optim.rate_of(group)
        };
        Self {
            optimizer: AdamW::new(optim, 0),
            moments: infos
                .iter()
                .map(|info| Moments::zeros(info.len()))
                .collect(),
            rates: infos.iter().map(rate).collect(),
            recipe,
            model: Some(model),
            loss: Box::new(loss),
            max_grad_norm,
            ema: None,
        }
    }

    fn with_ema(self, config: &EmaConfig) -> Self {
        let model = self.model.as_ref().expect("held between updates");
        Self {
            ema: Some((config.clone(), parameters::values(model))),
            ..self
        }
    }
}

impl<R: Recipe> Work for Training<R> {
    fn parameters(&self) -> usize {
        count(self.model.as_ref().expect("held between updates"))
    }

    fn step(&mut self) -> Result<Done> {
        let model = self.model.take().expect("held between updates");
        let mut loss = (self.loss)(&self.recipe, &model);
        let value = loss.total.clone().into_scalar::<f32>();
        (loss.terms, loss.probes) = (Vec::new(), Vec::new());
        let gradients = self.recipe.backward(&model, loss).into_host(&model);
        let scale = clip_factor(norm_of_squares(&squares(&gradients)), self.max_grad_norm);
        self.optimizer.begin_step();
        let steps = self.optimizer.steps();
        let (optimizer, rates, moments) = (&self.optimizer, &self.rates, &mut self.moments);
        let mut ema = self.ema.as_mut();
        self.model = Some(parameters::update(model, |index, parameter| {
            let moments = &mut moments[index];
            let average = ema.as_mut().and_then(|(ema, averages)| {
                let share = ema.share_at(steps)?;
                Some((&mut averages[index][..], share))
            });
            let step = optimizer.step(index, scale, rates[index]);
            moments.update(step, parameter, &gradients[index], average);
        }));
        Ok(Done {
            loss: Some(value),
            ..Done::default()
        })
    }
}

/// A sampler and its start noise.
struct Sampling {
    unet: UNet1d,
    diffusion: GaussianDiffusion,
    sampler: SamplerConfig,
    start_noise: Tensor<3>,
    cond: Tensor<3>,
}

impl Work for Sampling {
    fn parameters(&self) -> usize {
        count(&self.unet)
    }

    fn step(&mut self) -> Result<Done> {
        let drawn = sample(
            &self.diffusion,
            &self.unet,
            self.start_noise.clone(),
            &self.cond.clone().into(),
            &self.sampler,
            &ClipRange::None,
            Key::new(0, Purpose::Noise), // no noise is used: eta is 0
            &mut |_, _, _| std::ops::ControlFlow::Continue(()),
        )?;
        Ok(Done {
            sample: Some(drawn),
            ..Done::default()
        })
    }
}

/// The task of `row`, loaded onto `device`.
fn load(row: Row, folder: &Path, device: &Device) -> Result<Box<dyn Work>> {
    let diffusion = GaussianDiffusion::new(&DiffusionConfig {
        prediction_type: row.prediction_type,
        ..match &row.task {
            Task::TrainGmd { diffusion, .. } => diffusion.clone(),
            _ => DiffusionConfig::default(),
        }
    })?;
    let device = match row.task {
        Task::Sample { .. } | Task::DrawFlow { .. } | Task::Match => device.clone(),
        _ => device.clone().autodiff(),
    };
    let unet = || -> Result<UNet1d> {
        let Network::Unet1d(config) = &row.model else {
            return Err("the task is one of networks under audio".into());
        };
        let init = Initializer::new(0, &device);
        Ok(config.init(CHANNELS, AUDIO_CHANNELS, &init)?)
    };
    let inputs = NamedTensors::read(&folder.join("inputs.safetensors"), &device)?;
    if let Network::Matching(example) = &row.model {
        return Ok(Box::new(Matching::load(example, &inputs, device)?));
    }
    let weights = read_weights(&row.weights)?;
    let statistics = Arc::new(Statistics::unit(25));
    let held_out = HeldOut::nothing();
    Ok(match row.task {
        Task::Train {
            optim,
            max_grad_norm,
        } => {
            let model = parameters::load(unet()?, weights)?;
            let recipe = diffusion_recipe(diffusion, held_out);
            let (batch, draws) = (inputs.batch()?, inputs.draws()?);
            let loss = move |recipe: &DenoisingRecipe<UNet1d>, unet: &UNet1d| {
                recipe.loss_of(unet, batch.clone(), draws.clone())
            };
            Box::new(Training::new(recipe, model, &optim, max_grad_norm, loss))
        }
        Task::EndToEnd {
            optim,
            max_grad_norm,
            rollout,
        } => {
            let decoder = DecoderConfig {
                dropout: 0.0,
                init: DecoderInit::Random,
                ..DecoderConfig::default()
            };
            let normalization = Normalization {
                mean: statistics.mean.clone(),
                std: statistics.std.clone(),
            };
            let model = MotionModel {
                unet: unet()?,
                decoder: decoder.init(normalization, &Initializer::new(0, &device))?,
            };
            let model = parameters::load(model, weights)?;
            let last = diffusion.config.num_train_timesteps - 1;
            let sampler = Rollouts::new(diffusion, &rollout, statistics)?;
            let recipe = E2eRecipe::new(sampler, &LossConfig::ccmotion(), held_out);
            let batch = inputs.batch()?;
            let draws = E2eRandomInputs {
                denoising: inputs.draws()?,
                starts: vec![last; batch.x_start.dims()[0]],
                start_noise: inputs.tensor("x_T")?,
                decoder_dropout: None,
            };
            let loss = move |recipe: &E2eRecipe, model: &MotionModel| {
                recipe.loss_of(model, batch.clone(), draws.clone())
            };
            Box::new(Training::new(recipe, model, &optim, max_grad_norm, loss))
        }
        Task::TrainGmd {
            trajectory_scale,
            optim,
            max_grad_norm,
            ema,
            ..
        } => {
            let Network::GmdUnet(network) = &row.model else {
                return Err("the task is one of networks under a text".into());
            };
            let model = parameters::load(network.init(&device)?, weights)?;
            let channels = network.motion_channels;
            let own = GmdConfig {
                loss: GmdLossConfig {
                    trajectory_scale,
                    ..GmdLossConfig::default()
                },
                ..GmdConfig::default()
            };
            let recipe = clip_recipe(diffusion, channels, &own, None, None, held_out);
            let (batch, draws) = (inputs.clips()?, inputs.draws()?);
            let loss = move |recipe: &DenoisingRecipe<TextDenoiser>, model: &TextDenoiser| {
                recipe.loss_of(model, batch.clone(), draws.clone())
            };
            let training = Training::new(recipe, model, &optim, max_grad_norm, loss);
            Box::new(training.with_ema(&ema))
        }
        Task::Sample { sampler } => Box::new(Sampling {
            unet: parameters::load(unet()?, weights)?,
            diffusion,
            sampler,
            start_noise: inputs.tensor("x_T")?,
            cond: inputs.tensor("cond")?,
        }),
        Task::TrainFlow {
            optim,
            max_grad_norm,
            ema,
        } => {
            let model = parameters::load(flow::model(&row.model, &device)?, weights)?;
            let (recipe, loss) = flow::training(&inputs)?;
            let training = Training::new(recipe, model, &optim, max_grad_norm, loss);
            Box::new(training.with_ema(&ema))
        }
        Task::DrawFlow { steps } => {
            let model = parameters::load(flow::model(&row.model, &device)?, weights)?;
            Box::new(flow::Drawing::new(model, &inputs, steps)?)
        }
        Task::Match => return Err("the task is one of examples".into()),
    })
}

fn count<M: Module>(model: &M) -> usize {
    parameters::infos(model)
        .iter()
        .map(ParameterInfo::len)
        .sum()
}

/// A memory figure of this process in KiB, if the system has `/proc`.
fn status(field: &str) -> Option<u64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with(field))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

fn say(answer: &serde_json::Value) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "{answer}")?;
    Ok(stdout.flush()?)
}

fn main() -> Result<()> {
    kinegrad_kernels::memory::keep_freed();
    let start_kib = status("VmRSS:");
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, device] = arguments.as_slice() else {
        return Err("usage: bench_worker FOLDER DEVICE".into());
    };
    let (folder, (device, _)) = (Path::new(folder), kinegrad_train::device::open(device)?);
    let row = serde_json::from_str(&fs::read_to_string(folder.join("row.json"))?)?;
    let mut work = load(row, folder, &device)?;
    // Excludes the reading of files from the peak. If the peak cannot be reset, it is the larger of
    // both.
    let _ = fs::write("/proc/self/clear_refs", "5");
    say(&json!({"parameters": work.parameters(), "start_kib": start_kib}))?;

    let mut sample = None;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        match line.split_once(' ') {
            None if line == "step" => {
                let start = Instant::now();
                let done = work.step()?;
                device.sync()?;
                let seconds = start.elapsed().as_secs_f64();
                sample = done.sample;
                say(&json!({"seconds": seconds, "loss": done.loss, "peak_kib": status("VmHWM:")}))?;
            }
            Some(("save", path)) => {
                let sample = sample.clone().ok_or("nothing was sampled")?;
                let values: Vec<f32> = sample.try_into_vec_as()?;
                let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                fs::write(path, bytes)?;
                say(&json!({}))?;
            }
            _ => return Err(format!("`{line}` is neither `step` nor `save PATH`").into()),
        }
    }
    Ok(())
}
