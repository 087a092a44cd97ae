//! The networks of a config.

use burn::tensor::Device;
use kinegrad_models::Initializer;
use kinegrad_train::Error;
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::config::Config;
use kinegrad_train::memory::Footprint;

use super::FlowTables;
use crate::network::FlowModel;

pub(super) fn text_input(config: &Config) -> TextInput {
    TextInput::new(&config.own::<FlowTables>().text, &config.data)
}

/// Both networks with initial weights.
pub(super) fn model(config: &Config, device: &Device) -> Result<FlowModel, Error> {
    let own: &FlowTables = config.own();
    let skeleton = config.data.humanml3d.skeleton();
    let init = Initializer::new(config.run.seed, device);
    let model = own.model.network.sizes().init(&skeleton, &init)?;
    Ok(match text_input(config).labels() {
        Some(labels) => model.with_captions(labels.captions().len(), &init),
        None => model,
    })
}

pub(super) fn footprint(config: &Config) -> Result<Footprint, Error> {
    let own: &FlowTables = config.own();
    let skeleton = config.data.humanml3d.skeleton();
    let (sizes, joints) = (own.model.network.sizes(), skeleton.joints());
    let history = own.pose.history_frames;
    let of_frame = joints * (47 + 2 * sizes.joint_dim + 2 * sizes.context_dim);
    let of_token = 49 + sizes.num_layers * (12 * sizes.latent_dim + 2 * sizes.ff_size);
    let recurrent = history * 12 * sizes.gru_dim;
    let activations = history * of_frame + recurrent + joints * of_token;
    let item = history * skeleton.layout().channels() + text_input(config).channels();
    let model = model(config, &Device::flex())?;
    Ok(Footprint::of(&model, activations as u64, item))
}
