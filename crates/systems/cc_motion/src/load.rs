//! The networks of a checkpoint of any recipe.

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_models::parameters::ParameterInfo;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::{ChannelEncoding, Phrases, Statistics};
use kinegrad_train::checkpoint::{SavedCheckpoint, State, Weights};
use kinegrad_train::config::Config;
use kinegrad_train::memory::Footprint;
use kinegrad_train::{Error, ParameterCount, is_adapter};

use super::recipe_name::RecipeName;
use super::{CcMotionConfig, CcMotionNetwork};
use crate::network::decoder::{DecoderInit, Normalization};
use crate::network::{DecoderConfig, MotionDecoder, MotionModel, UNet1d, UNet1dConfig};

/// Names of the networks of a model with both networks.
const NETWORKS: &[&str] = &["unet", "decoder"];

/// Trained networks, with merged adapters, and the state of their training.
pub struct Trained {
    /// The denoiser.
    pub unet: UNet1d,
    /// The decoder, for recipes with a decoder.
    pub decoder: Option<MotionDecoder>,
    /// Config, step, statistics.
    pub state: State,
}

impl Trained {
    /// Loads a checkpoint onto `device`.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not match its config.
    pub fn load(saved: &SavedCheckpoint, weights: Weights, device: &Device) -> Result<Self, Error> {
        let state = saved.state.clone();
        let config = &state.config;
        let (unet, decoder) = if RecipeName::of(config).trains_through_sampler() {
            state.statistics_of(&Phrases)?;
            let fresh = networks(config, state.normalization(), device)?;
            let MotionModel { unet, decoder } = saved.load(fresh, weights)?;
            (unet.merge_adapters(), Some(decoder))
        } else {
            (saved.load(denoiser(config, device)?, weights)?, None)
        };
        Ok(Self {
            unet,
            decoder,
            state,
        })
    }
}

/// The denoiser of a config, with fresh weights.
pub(crate) fn denoiser(config: &Config, device: &Device) -> Result<UNet1d, Error> {
    let unet = unet1d(config);
    let init = Initializer::new(config.run.seed, device);
    let audio = config.data.audio_layout().channels();
    let scale = config.own::<CcMotionConfig>().diffusion.timestep_scale();
    let unet = unet.init(unet.targets().channels(), audio, &init)?;
    Ok(unet.with_timestep_scale(scale))
}

/// The settings of the denoiser of a config.
pub(super) fn unet1d(config: &Config) -> &UNet1dConfig {
    let CcMotionNetwork::Unet1d(unet) = &config.own::<CcMotionConfig>().model.network;
    unet
}

/// The channels that the denoiser of a config predicts.
pub(crate) fn targets(config: &Config) -> ChannelEncoding {
    unet1d(config).targets()
}

/// The decoder of a config, with fresh weights; `statistics` normalized the networks' channels.
pub(crate) fn decoder(
    config: &Config,
    statistics: &Statistics,
    device: &Device,
) -> Result<MotionDecoder, Error> {
    let normalization = Normalization {
        mean: statistics.mean.clone(),
        std: statistics.std.clone(),
    };
    let init = Initializer::new(config.run.seed, device).at("decoder");
    let decoder = &config.own::<CcMotionConfig>().decoder;
    Ok(decoder.init_for(targets(config), normalization, &init)?)
}

/// The parameters of a config's networks as its recipe trains them.
pub(super) fn parameter_count(config: &Config) -> Result<ParameterCount, Error> {
    let unet = denoiser(config, &Device::flex())?;
    let recipe = RecipeName::of(config);
    if !recipe.trains_through_sampler() {
        return Ok(ParameterCount::trained(&unet));
    }
    let adapts = config.own::<CcMotionConfig>().lora.is_some();
    let infos = parameters::infos(&lazy_model(config, unet)?);
    // As in `trainable`, without initializing weights.
    let trains = |info: &ParameterInfo| match adapts {
        true => is_adapter(info),
        false => recipe != RecipeName::Decoder,
    };
    Ok(ParameterCount::of(&infos, NETWORKS, |_, info| {
        !info.name.starts_with("unet.") || trains(info)
    }))
}

/// `unet` with the adapters and the decoder of a config, with lazy parameters.
fn lazy_model(config: &Config, unet: UNet1d) -> Result<MotionModel, Error> {
    let (own, init) = (
        config.own::<CcMotionConfig>(),
        Initializer::new(0, &Device::flex()),
    );
    let unet = match &own.lora {
        Some(lora) => unet.with_adapters(lora, &init)?,
        None => unet,
    };
    let random = DecoderConfig {
        init: DecoderInit::Random,
        ..own.decoder.clone()
    };
    let targets = targets(config);
    let unit = Normalization {
        mean: vec![0.0; targets.channels()],
        std: vec![1.0; targets.channels()],
    };
    let decoder = random.init_for(targets, unit, &init)?;
    Ok(MotionModel { unet, decoder })
}

/// The training memory of a config's networks.
pub(super) fn footprint(config: &Config, frames: usize) -> Result<Footprint, Error> {
    let own: &CcMotionConfig = config.own();
    let network = unet1d(config);
    let unet = denoiser(config, &Device::flex())?;
    let a_pass = network.activations(frames);
    let checkpoints = own.model.activation_checkpointing;
    let audio = config.data.audio_layout().channels();
    let item = (network.targets().channels() + audio) * frames;
    if !RecipeName::of(config).trains_through_sampler() {
        return Ok(Footprint::of(&unet, a_pass, item).checkpointed(checkpoints));
    }
    let activations = a_pass + own.decoder.activations(frames);
    let footprint = Footprint {
        passes: own.rollout.stored_passes(),
        shared: own.decoder.shared(frames),
        ..Footprint::of(&lazy_model(config, unet)?, activations, item)
    };
    Ok(footprint.checkpointed(checkpoints))
}

/// Denoiser and decoder as the config's recipe trains them, with fresh weights.
pub(crate) fn networks(
    config: &Config,
    statistics: &Statistics,
    device: &Device,
) -> Result<MotionModel, Error> {
    let model = MotionModel {
        unet: denoiser(config, device)?,
        decoder: decoder(config, statistics, device)?,
    };
    trainable(model, config, device)
}

/// `model` as its recipe trains it: recipe `decoder` and adapters freeze the denoiser's weights.
pub(crate) fn trainable(
    model: MotionModel,
    config: &Config,
    device: &Device,
) -> Result<MotionModel, Error> {
    let MotionModel { unet, decoder } = model;
    let unet = match &config.own::<CcMotionConfig>().lora {
        Some(lora) => {
            let init = Initializer::new(config.run.seed, device).at("unet");
            unet.with_adapters(lora, &init)?
        }
        None if RecipeName::of(config) == RecipeName::Decoder => unet.no_grad(),
        None => unet,
    };
    Ok(MotionModel { unet, decoder })
}
