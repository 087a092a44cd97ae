//! Published PyTorch checkpoints as runs (docs/sources.md, section 6.1).

use std::collections::BTreeMap;
use std::path::Path;

use crate::network::{BlendedConfig, HEAD_CHANNELS};
use burn::tensor::Device;
use kinegrad_models::NetworkConfig;
use kinegrad_motion::humanml::{Root, TEXT_CHANNELS};
use kinegrad_motion::{Representation, Statistics};
use kinegrad_settings::require;
use pytorch_reader::Tensor;

use super::load::network;
use super::{BpeNetwork, BpeTables, BpeTransformer, RECIPE};
use kinegrad_train::Error;
use kinegrad_train::Systems;
use kinegrad_train::checkpoint::must_be_free;
use kinegrad_train::config::{Config, OwnTables};
use kinegrad_train::import::{ImportRequest, Imported, needed, skeleton_of};
use kinegrad_train::published::{self, mean_and_deviation, read_tensors};

/// Names of the architectures that [`import`] knows.
pub(super) const ARCHITECTURES: [&str; 1] = ["flowmdm"];

/// Names of the published program that are no weights of the network: the text encoder, and tables
/// that are formulas.
fn is_known_stranger(name: &str) -> bool {
    let tables = [
        "sequence_pos_encoder.pe",
        "embed_timestep.sequence_pos_encoder.pe",
        "t_pos_encoder.pe",
        "seqTransEncoder.attn_layers.rotary_pos_emb.relative.inv_freq",
        "seqTransEncoder.attn_layers.rotary_pos_emb.last_timestep",
    ];
    name.starts_with("clip_model.") || tables.contains(&name)
}

/// Reads published weights and writes them as the only checkpoint of a run, for sampling; it has no
/// optimiser to resume with.
///
/// # Errors
/// If a file cannot be read, a parameter is missing, superfluous, of another shape or not finite
/// (all of them are listed), or statistics do not fit. Nothing is written then.
pub(super) fn import(request: &ImportRequest) -> Result<Imported, Error> {
    let (Some(mean), Some(std)) = (&request.mean, &request.std) else {
        let message = "the statistics of the weights' training data are missing";
        let hint = "give option `mean Mean.npy` and option `std Std.npy`, those of HumanML3D with its relative root";
        return Err(Error::usage(message, hint));
    };
    if request.projection.is_some() {
        let message = format!(
            "option `projection` with option `arch {}`",
            request.architecture
        );
        return Err(Error::usage(
            message,
            "it is of option `arch gmd_motion`: leave it out",
        ));
    }
    if request.last {
        let message = format!("option `last` with option `arch {}`", request.architecture);
        return Err(Error::usage(
            message,
            "its files have one set of weights: leave it out",
        ));
    }
    must_be_free(&request.out)?;
    let tensors = read_tensors(&request.weights)?;
    let (tensors, skipped) = needed(tensors, is_known_stranger);
    let (config, statistics) = settings(request, [mean, std], &tensors)?;
    let model = network(&config, &Device::flex())?;
    let model = published::load(&request.weights, model, &tensors)?;
    Ok(Imported {
        skipped,
        ..Imported::write(request, &model, config, statistics)?
    })
}

/// The size of a tensor along an axis.
fn size(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    name: &str,
    axis: usize,
) -> Result<usize, Error> {
    let shape = tensors.get(name).map(Tensor::shape);
    let found = shape.and_then(|shape| shape.get(axis).copied());
    found.ok_or_else(|| Error::Foreign {
        path: path.to_path_buf(),
        reason: format!("it has no `{name}`: these are not the weights of FlowMDM"),
    })
}

/// The network according to the shapes of the weights; horizon and dropout are those of `base`.
fn sizes(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    base: &BlendedConfig,
) -> Result<BlendedConfig, Error> {
    let size = |name: &str, axis| size(path, tensors, name, axis);
    let layers = "seqTransEncoder.attn_layers.layers";
    let count =
        (0..).take_while(|layer| tensors.contains_key(&format!("{layers}.{layer}.0.0.weight")));
    let config = BlendedConfig {
        latent_dim: size("input_process.poseEmbedding.weight", 0)?,
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
    let foreign = |reason: String| Error::Foreign {
        path: request.weights.clone(),
        reason,
    };
    let channels = config.data.humanml3d.representation().channels();
    let found = size(
        &request.weights,
        tensors,
        "output_process.poseFinal.weight",
        0,
    )?;
    if found != channels {
        return Err(foreign(format!(
            "it is a network of {found} channels, and these statistics are of {channels}; models of \
             BABEL (135) need a licensed body to be of use and are not read"
        )));
    }
    let found = size(&request.weights, tensors, "embed_text.weight", 1)?;
    if found != TEXT_CHANNELS {
        return Err(foreign(format!(
            "it takes {found} numbers of a text, and embeddings have {TEXT_CHANNELS}"
        )));
    }
    let mut own = config.own::<BpeTables>().clone();
    own.model.size = BlendedConfig::SIZES[0].0.into();
    let sizes = sizes(&request.weights, tensors, own.model.network.sizes())?;
    own.model.network = BpeNetwork::BpeTransformer(sizes);
    config.system = OwnTables::new(own);
    Ok((config, Statistics::new(mean, std, Some(Root::Relative))?))
}
