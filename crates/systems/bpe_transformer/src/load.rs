//! The network of a config.

use std::collections::HashMap;

use burn::tensor::Device;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::Representation;
use kinegrad_motion::humanml::TEXT_CHANNELS;
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::training::must_fit_clips;
use kinegrad_train::config::{Config, OwnTables};
use kinegrad_train::memory::Footprint;
use kinegrad_train::start::{Start, must_agree};
use kinegrad_train::{Error, ParameterCount};

use super::config::{is_path_conditioned, with_paths};
use super::{ADAPTER, BpeTables, INHERITED};
use crate::network::BlendedTransformer;

pub(super) fn text_input(config: &Config) -> TextInput {
    TextInput::new(&config.own::<BpeTables>().text, &config.data)
}

/// The network with initial weights.
pub(super) fn network(config: &Config, device: &Device) -> Result<BlendedTransformer, Error> {
    let own: &BpeTables = config.own();
    let init = Initializer::new(config.run.seed, device);
    let channels = config.data.humanml3d.representation().channels();
    let sizes = own.model.network.sizes();
    let network = sizes.init(channels, TEXT_CHANNELS, &init)?;
    Ok(match text_input(config).labels() {
        Some(labels) => network.with_captions(labels.captions().len(), &init),
        None => network,
    })
}

/// The initial network of training, with the weights of an optional `start`. Recipe `path_adapter`
/// freezes all except the trained part.
pub(super) fn initial_network(
    config: &Config,
    start: Option<&Start>,
    device: &Device,
) -> Result<BlendedTransformer, Error> {
    let fresh = match start {
        Some(start) => started(start, config, device)?,
        None => network(config, device)?,
    };
    Ok(match config.train.recipe == ADAPTER {
        true => fresh.adapting(config.own::<BpeTables>().adapter.last_layers),
        false => fresh,
    })
}

/// The network of a config with the weights of `start`; other weights are initialized.
fn started(start: &Start, config: &Config, device: &Device) -> Result<BlendedTransformer, Error> {
    let state = start.state();
    let network = start.load(|saved| trained(saved, Weights::Ema, device))?;
    must_fit_clips(start, config)?;
    let mut base = state.config.clone();
    let has_path = base.own::<BpeTables>().model.network.sizes().path;
    if is_path_conditioned(config) && !has_path {
        let tokens = config.own::<BpeTables>().model.network.sizes().path_tokens;
        base.system = OwnTables::unread(with_paths(base.system.to_table(), tokens));
    }
    must_agree(config, &base, &INHERITED)?;
    let fresh = self::network(config, device)?;
    let weights = parameters::export(&network).into_iter();
    let mut weights: HashMap<String, Vec<f32>> = weights
        .map(|weight| (weight.info.name, weight.values))
        .collect();
    let values = parameters::export(&fresh).into_iter();
    let values = values.map(|own| weights.remove(&own.info.name).unwrap_or(own.values));
    let values = values.collect();
    Ok(parameters::replace(fresh, values))
}

pub(super) fn trained(
    saved: &SavedCheckpoint,
    weights: Weights,
    device: &Device,
) -> Result<BlendedTransformer, Error> {
    saved.state.clip_statistics()?;
    saved.load(network(&saved.state.config, device)?, weights)
}

pub(super) fn parameters(config: &Config) -> Result<ParameterCount, Error> {
    let network = network(config, &Device::flex())?;
    let infos = parameters::infos(&network);
    let adapts =
        (config.train.recipe == ADAPTER).then(|| config.own::<BpeTables>().adapter.last_layers);
    Ok(ParameterCount::of(&infos, &[], |_, info| {
        adapts.is_none_or(|last| network.adapts(&info.name, last))
    }))
}

pub(super) fn footprint(config: &Config, frames: usize) -> Result<Footprint, Error> {
    let model = &config.own::<BpeTables>().model;
    let sizes = model.network.sizes();
    let channels = config.data.humanml3d.representation().channels();
    let item = channels * frames + text_input(config).channels();
    let network = network(config, &Device::flex())?;
    let footprint = Footprint::of(&network, sizes.activations(frames), item);
    Ok(footprint.checkpointed(model.activation_checkpointing))
}
