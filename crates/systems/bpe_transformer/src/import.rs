//! Published PyTorch checkpoints as runs (docs/sources.md, section 6.1).

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use kinegrad_models::NetworkConfig;
use kinegrad_motion::humanml::{Root, TEXT_CHANNELS};
use kinegrad_motion::{Representation, Statistics};
use kinegrad_settings::require;
use kinegrad_train::checkpoint::must_be_free;
use kinegrad_train::config::{Config, OwnTables};
use kinegrad_train::import::{ImportRequest, Imported, needed, size, skeleton_of};
use kinegrad_train::published::{self, mean_and_deviation, part_of, read_tensors, without_prefix};
use kinegrad_train::{Error, Systems};
use pytorch_reader::Tensor;

use super::load::network;
use super::{BpeNetwork, BpeTables, BpeTransformer, RECIPE};
use crate::network::{BlendedConfig, HEAD_CHANNELS};

pub(super) const ARCHITECTURES: [&str; 1] = ["flowmdm"];

/// Stored tables of the published program that kinegrad computes by formulas.
const TABLES: [&str; 3] = [
    "t_pos_encoder.pe",
    "seqTransEncoder.attn_layers.rotary_pos_emb.relative.inv_freq",
    "seqTransEncoder.attn_layers.rotary_pos_emb.last_timestep",
];

/// Reads published weights and writes a run with one checkpoint, for sampling. Training cannot
/// resume: the checkpoint has no optimizer state.
pub(super) fn import(request: &ImportRequest) -> Result<Imported, Error> {
    let hint = "give option `mean Mean.npy` and option `std Std.npy`, those of HumanML3D with its relative root";
    let statistics = request.statistics(hint)?;
    if request.projection.is_some() {
        let hint = "it is of option `arch gmd_motion`: leave it out";
        return Err(request.refused("projection", hint));
    }
    if request.last {
        let hint = "its files have one set of weights: leave it out";
        return Err(request.refused("last", hint));
    }
    request.must_not_pad()?;
    must_be_free(&request.out)?;
    let tensors = read_tensors(&request.weights)?;
    let inside = part_of(&tensors, "model");
    let tensors = match inside.is_empty() {
        true => without_prefix(tensors, &[INPUT]),
        false => inside,
    };
    let (tensors, skipped) = needed(tensors, &TABLES);
    let (config, statistics) = settings(request, statistics, &tensors)?;
    let model = network(&config, &Device::flex())?;
    let model = published::load(&request.weights, model, &tensors)?;
    Ok(Imported {
        skipped,
        ..Imported::write(request, &model, config, statistics)?
    })
}

/// A tensor of each network.
const INPUT: &str = "input_process.poseEmbedding.weight";

/// The network according to the shapes of the weights; `base` gives horizon and dropout.
fn sizes(
    size: impl Fn(&str, usize) -> Result<usize, Error>,
    tensors: &BTreeMap<String, Tensor>,
    base: &BlendedConfig,
) -> Result<BlendedConfig, Error> {
    let layers = "seqTransEncoder.attn_layers.layers";
    let count =
        (0..).take_while(|layer| tensors.contains_key(&format!("{layers}.{layer}.0.0.weight")));
    let config = BlendedConfig {
        latent_dim: size(INPUT, 0)?,
        num_layers: count.count() / 2,
        num_heads: size(&format!("{layers}.0.1.to_q.weight"), 0)? / HEAD_CHANNELS,
        ff_size: size(&format!("{layers}.1.1.ff.0.0.weight"), 0)?,
        ..base.clone()
    };
    config.validate()?;
    Ok(config)
}

/// The config that describes the weights, and the statistics of their data.
fn settings(
    request: &ImportRequest,
    [mean_path, std_path]: [&Path; 2],
    tensors: &BTreeMap<String, Tensor>,
) -> Result<(Config, Statistics), Error> {
    let text = format!("[train]\nrecipe = \"{RECIPE}\"\n");
    let systems = Systems(&[&BpeTransformer]);
    let mut config = systems.parse(&text, "the recipe's defaults", &request.overrides)?;
    let [mean, std] = mean_and_deviation(mean_path, std_path)?;
    config.data.humanml3d.skeleton = skeleton_of(&mean, mean_path)?;
    require(
        config.data.humanml3d.root == Root::Relative,
        "data.humanml3d.root",
        "\"absolute\"",
        "\"relative\", as the published models were trained",
    )?;
    let size = |name: &str, axis| {
        size(tensors, name, axis).ok_or_else(|| request.lacking(name, "FlowMDM"))
    };
    let channels = config.data.humanml3d.representation().channels();
    let found = size("output_process.poseFinal.weight", 0)?;
    if found != channels {
        return Err(request.foreign(format!(
            "it is a network of {found} channels, and these statistics are of {channels}; models of \
             BABEL (135) need a licensed body to be of use and are not read"
        )));
    }
    let found = size("embed_text.weight", 1)?;
    if found != TEXT_CHANNELS {
        return Err(request.foreign(format!(
            "it takes {found} numbers of a text, and embeddings have {TEXT_CHANNELS}"
        )));
    }
    let mut own = config.own::<BpeTables>().clone();
    own.model.size = BlendedConfig::SIZES[0].0.into();
    let sizes = sizes(size, tensors, own.model.network.sizes())?;
    own.model.network = BpeNetwork::BpeTransformer(sizes);
    config.system = OwnTables::new(own);
    Ok((config, Statistics::new(mean, std, Some(Root::Relative))?))
}
