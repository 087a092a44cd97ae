//! The network of a config.

use std::path::Path;

use burn::tensor::Device;
use kinegrad_models::blended::BlendedTransformer;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::humanml::TEXT_CHANNELS;
use kinegrad_motion::{Representation, Statistics};

use super::BpeTables;
use crate::captions::TextInput;
use crate::checkpoint::{State, Weights, read_weights};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::memory::Footprint;

/// The network with fresh weights.
///
/// # Errors
/// If it cannot be built.
pub(super) fn network(config: &Config, device: &Device) -> Result<BlendedTransformer, Error> {
    let own = BpeTables::of(config)?;
    let init = Initializer::new(config.run.seed, device);
    let channels = config.data.humanml3d.representation().channels();
    let network = own
        .model
        .network
        .sizes()
        .init(channels, TEXT_CHANNELS, &init)?;
    Ok(match TextInput::of(config)?.labels() {
        Some(labels) => network.with_captions(labels.captions().len(), &init),
        None => network,
    })
}

/// That of the checkpoint in `path`.
///
/// # Errors
/// If the checkpoint is damaged or does not fit its own config.
pub(super) fn trained(
    path: &Path,
    weights: Weights,
    device: &Device,
) -> Result<(BlendedTransformer, State), Error> {
    let state = State::read(path)?;
    let values = read_weights(path, &state, weights)?;
    statistics_in(&state)?;
    let network = parameters::load(network(&state.config, device)?, values)?;
    Ok((network, state))
}

/// The statistics of a run.
///
/// # Errors
/// [`Error::OtherRepresentation`] for a run of another system.
pub(super) fn statistics_in(state: &State) -> Result<&Statistics, Error> {
    state.statistics_of(&state.config.data.humanml3d.representation())
}

/// Number of parameters.
///
/// # Errors
/// As [`network`].
pub(super) fn parameter_count(config: &Config) -> Result<usize, Error> {
    // Parameters are lazy: no weight is drawn and no memory taken.
    Ok(parameters::count(&network(config, &Device::flex())?))
}

/// What the network takes for motions of `frames` frames.
///
/// # Errors
/// As [`network`].
pub(super) fn footprint(config: &Config, frames: usize) -> Result<Footprint, Error> {
    let sizes = BpeTables::of(config)?.model.network.sizes().clone();
    let channels = config.data.humanml3d.representation().channels();
    Ok(Footprint {
        parameters: parameter_count(config)? as u64,
        activations: sizes.activations(frames),
        passes: 1,
        item: (channels * frames + TextInput::of(config)?.channels()) as u64,
        shared: 0,
    })
}
