//! The networks of a config or a checkpoint.

use burn::tensor::Device;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::Representation;
use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisProjection};
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;
use kinegrad_train::checkpoint::{SavedCheckpoint, State, Weights};
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::training::must_fit_clips;
use kinegrad_train::config::Config;
use kinegrad_train::memory::Footprint;
use kinegrad_train::start::{Start, must_agree};
use kinegrad_train::{Error, ParameterCount};

use super::GmdConfig;
use super::recipe_name::RecipeName;
use crate::network::TextDenoiser;

pub(super) const MATRIX: &str = "projection.matrix";

/// Channels of inputs and outputs of the networks.
pub fn channels_of(config: &Config) -> usize {
    match RecipeName::of(config) {
        RecipeName::Motion => config.data.humanml3d.representation().channels(),
        RecipeName::Trajectory => TRAJECTORY_CHANNELS,
    }
}

pub(super) fn text_input(config: &Config) -> TextInput {
    TextInput::new(&config.own::<GmdConfig>().text, &config.data)
}

/// The denoiser with initial weights, in the space of normalized motion.
///
/// # Errors
/// If it cannot be built.
pub fn text_denoiser(
    config: &Config,
    channels: usize,
    device: &Device,
) -> Result<TextDenoiser, Error> {
    let backbone = &config.own::<GmdConfig>().model.network;
    let init = Initializer::new(config.run.seed, device);
    let denoiser = TextDenoiser::new(backbone, channels, &init)?;
    Ok(match text_input(config).labels() {
        Some(labels) => denoiser.with_captions(labels.captions().len(), &init),
        None => denoiser,
    })
}

/// The parameters of a config's denoiser; the matrix of the denoiser's space is not trained.
pub(super) fn parameters_in_space(config: &Config) -> Result<ParameterCount, Error> {
    let infos = parameters::infos(&model_in_space(config, &Device::flex())?);
    let is_trained = |index: usize| infos[index].name != MATRIX;
    Ok(ParameterCount::of(&infos, &[], |index, _| {
        is_trained(index)
    }))
}

pub(super) fn footprint(config: &Config, frames: usize) -> Result<Footprint, Error> {
    let channels = channels_of(config);
    let item = channels * frames + text_input(config).channels();
    let model = &config.own::<GmdConfig>().model;
    let activations = model.network.activations(frames);
    let network = text_denoiser(config, channels, &Device::flex())?;
    let footprint = Footprint::of(&network, activations, item);
    Ok(footprint.checkpointed(model.activation_checkpointing))
}

/// [`text_denoiser`] in the space of the config's `emphasis`.
///
/// # Errors
/// If it cannot be built.
pub fn model_in_space(config: &Config, device: &Device) -> Result<TextDenoiser, Error> {
    let channels = channels_of(config);
    let model = text_denoiser(config, channels, device)?;
    let projection = match RecipeName::of(config) {
        RecipeName::Motion => config.own::<GmdConfig>().emphasis.projection(channels)?,
        RecipeName::Trajectory => None,
    };
    Ok(match projection {
        Some(projection) => model.in_space_of(projection.matrix().to_vec(), device),
        None => model,
    })
}

/// The projection with a stored matrix.
pub(super) fn projection_of(
    emphasis: &EmphasisConfig,
    matrix: &[f32],
    channels: usize,
) -> Result<EmphasisProjection, Error> {
    let (scale, emphasised) = (emphasis.scale, &emphasis.channels);
    Ok(EmphasisProjection::from_matrix(
        matrix, channels, scale, emphasised,
    )?)
}

/// A trained denoiser of clips.
pub struct TrainedClips {
    /// The network.
    pub model: TextDenoiser,
    /// The projection of the network's space, if any.
    pub projection: Option<EmphasisProjection>,
    /// Config, step and statistics.
    pub state: State,
}

impl TrainedClips {
    /// Loads a checkpoint onto `device`.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn load(saved: &SavedCheckpoint, weights: Weights, device: &Device) -> Result<Self, Error> {
        let channels = channels_of(&saved.state.config);
        let state = saved.state.clone();
        let values = saved.weights(weights)?;
        let mut model = text_denoiser(&state.config, channels, device)?;
        // Uses the stored matrix instead of the config's matrix.
        let matrix = values.iter().find(|p| p.info.name == MATRIX);
        let mut projection = None;
        if let Some(matrix) = matrix {
            let emphasis = &state.config.own::<GmdConfig>().emphasis;
            projection = Some(projection_of(emphasis, &matrix.values, channels)?);
            model = model.in_space_of(matrix.values.clone(), device);
        }
        let model = parameters::load(model, values)?;
        state.clip_statistics()?;
        Ok(Self {
            model,
            projection,
            state,
        })
    }
}

/// The averaged weights of `start`, in the space of `start`, on an autodiff device.
pub(super) fn started(
    start: &Start,
    config: &Config,
    device: &Device,
) -> Result<TextDenoiser, Error> {
    let trained = start.load(|saved| TrainedClips::load(saved, Weights::Ema, device))?;
    let base = &trained.state.config;
    let (recipe, found) = (&config.train.recipe, &base.train.recipe);
    if recipe != found {
        return Err(start.refused(&format!("its recipe is `{found}`, not `{recipe}`")));
    }
    must_agree(config, base, &INHERITED)?;
    must_fit_clips(start, config)?;
    let fresh = text_denoiser(config, channels_of(config), device)?;
    let fresh = match &trained.projection {
        Some(projection) => fresh.in_space_of(projection.matrix().to_vec(), device),
        None => fresh,
    };
    let weights = parameters::values(&trained.model);
    Ok(parameters::replace(fresh, weights))
}

/// Tables that a run inherits from its initial checkpoint.
pub(super) const INHERITED: [&str; 4] = ["model", "text", "diffusion", "emphasis"];
