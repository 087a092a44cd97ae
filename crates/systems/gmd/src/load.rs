//! The networks of runs on clips: built from a config, read from a checkpoint, started from one.

use crate::network::TextDenoiser;
use burn::tensor::Device;
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_motion::Representation;
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;

use super::GmdConfig;
use super::recipe_name::RecipeName;
use kinegrad_train::Error;
use kinegrad_train::ParameterCount;
use kinegrad_train::checkpoint::{SavedCheckpoint, State, Weights};
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::training::must_fit_clips;
use kinegrad_train::config::Config;
use kinegrad_train::memory::Footprint;
use kinegrad_train::start::{Start, must_agree};

/// Parameter of the matrix of a projected space.
pub(super) const MATRIX: &str = "projection.matrix";

/// Channels that the networks of a run of `config` take and give.
pub fn channels_of(config: &Config) -> usize {
    match RecipeName::of(config) {
        RecipeName::Motion => config.data.humanml3d.representation().channels(),
        RecipeName::Trajectory => TRAJECTORY_CHANNELS,
    }
}

/// The text input of the network of a config.
pub(super) fn text_input(config: &Config) -> TextInput {
    TextInput::new(&config.own::<GmdConfig>().text, &config.data)
}

/// The denoiser of a config with fresh weights, in the space of normalised motion.
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

/// The parameters of a config's denoiser as it is trained: with the matrix of its space, which
/// stays as it is.
///
/// # Errors
/// If it cannot be built.
pub(super) fn parameters_in_space(config: &Config) -> Result<ParameterCount, Error> {
    let infos = parameters::infos(&model_in_space(config, &Device::flex())?);
    Ok(ParameterCount::of(&infos, &[], |_, info| {
        info.name != MATRIX
    }))
}

/// The memory of a config's networks for clips of `frames` frames.
///
/// # Errors
/// If one cannot be built.
pub(super) fn footprint(config: &Config, frames: usize) -> Result<Footprint, Error> {
    let channels = channels_of(config);
    let item = channels * frames + text_input(config).channels();
    let activations = config.own::<GmdConfig>().model.network.activations(frames);
    let network = text_denoiser(config, channels, &Device::flex())?;
    Ok(Footprint::of(&network, activations, item))
}

/// [`text_denoiser`] in the space that `emphasis` of the config makes.
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

/// A trained denoiser of clips.
pub struct TrainedClips {
    /// The network.
    pub model: TextDenoiser,
    /// The space it works in, where that is a projected one.
    pub projection: Option<EmphasisProjection>,
    /// Config, step, statistics of its training clips.
    pub state: State,
}

impl TrainedClips {
    /// Loads a checkpoint onto `device`.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not fit its own config.
    pub fn load(saved: &SavedCheckpoint, weights: Weights, device: &Device) -> Result<Self, Error> {
        let channels = channels_of(&saved.state.config);
        let state = saved.state.clone();
        let values = saved.weights(weights)?;
        let mut model = text_denoiser(&state.config, channels, device)?;
        // The stored matrix counts, whatever the config would make today.
        let matrix = values.iter().find(|p| p.info.name == MATRIX);
        let projection = match matrix {
            Some(matrix) => {
                let emphasis = &state.config.own::<GmdConfig>().emphasis;
                let projection = EmphasisProjection::from_matrix(
                    &matrix.values,
                    channels,
                    emphasis.scale,
                    &emphasis.channels,
                )?;
                model = model.in_space_of(matrix.values.clone(), device);
                Some(projection)
            }
            None => None,
        };
        let model = parameters::load(model, values)?;
        state.clip_statistics()?;
        Ok(Self {
            model,
            projection,
            state,
        })
    }
}

/// The averaged weights of `start`, in its space, on an autodiff device.
///
/// # Errors
/// Names the key in which the start differs from `config`.
pub(super) fn started(
    start: &Start,
    config: &Config,
    device: &Device,
) -> Result<TextDenoiser, Error> {
    let trained = start.load(|saved| TrainedClips::load(saved, Weights::Ema, device))?;
    let base = &trained.state.config;
    let (given, recipe) = (&config.train.recipe, &base.train.recipe);
    if given != recipe {
        return Err(start.refused(&format!("its recipe is `{recipe}`, not `{given}`")));
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

/// Tables that follow from what a run starts from.
pub(super) const INHERITED: [&str; 4] = ["model", "text", "diffusion", "emphasis"];
