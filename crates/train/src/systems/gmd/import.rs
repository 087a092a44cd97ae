//! Published PyTorch checkpoints as runs (docs/sources.md, section 4.4).

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use kinegrad_data::humanml::SkeletonName;
use kinegrad_models::gmd::GmdUnetConfig;
use kinegrad_models::{Backbone, NetworkConfig, parameters};
use kinegrad_motion::Statistics;
use kinegrad_motion::emphasis::{EmphasisKind, EmphasisProjection};
use kinegrad_motion::humanml::Root;
use pytorch_reader::Tensor;

use super::networks::{channels_of, text_denoiser};
use super::recipe_name::RecipeName;
use super::{Gmd, GmdConfig};
use crate::checkpoint::{FORMAT, Progress, State, must_be_free, write_weights};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::import::{ImportRequest, Imported};
use crate::published::{self, array, part_of, read_tensors, vector};
use crate::system::Systems;

/// Names of the published programs that are no weights of the network: the text encoder and the
/// tables of positions.
fn is_known_stranger(name: &str) -> bool {
    name.starts_with("clip_model.")
        || name == "sequence_pos_encoder.pe"
        || name == "embed_timestep.sequence_pos_encoder.pe"
}

/// Reads published weights and writes them as the only checkpoint of a run, from which samples are
/// drawn and trainings start; it has no optimiser to resume with.
///
/// # Errors
/// If a file cannot be read, a parameter is missing, superfluous, of another shape or not finite
/// (all of them are listed), or statistics or matrix do not fit. Nothing is written then.
pub fn import(request: &ImportRequest) -> Result<Imported, Error> {
    let (Some(mean), Some(std)) = (&request.mean, &request.std) else {
        let message = "the statistics of the weights' training data are missing";
        let hint = "give `--mean M.npy --std S.npy`, those that the model was trained with: for an \
                    absolute root Mean_abs_3d.npy and Std_abs_3d.npy";
        return Err(Error::usage(message, hint));
    };
    let mut warnings = Vec::new();
    match (
        request.architecture == RecipeName::Motion.name(),
        &request.projection,
    ) {
        (true, None) => warnings.push(
            "no `--projection`: published motion models work in a projected space and do not work \
             without their projection matrix"
                .to_string(),
        ),
        (false, Some(_)) => {
            let message = format!("`--projection` with `--arch {}`", request.architecture);
            let hint = "trajectory models use no projection";
            return Err(Error::usage(message, hint));
        }
        _ => {}
    }
    must_be_free(&request.out)?;
    let (part, tensors) = read_weights(&request.weights, request.last)?;
    let all = tensors.len();
    let tensors: BTreeMap<String, Tensor> = tensors
        .into_iter()
        .filter(|(name, _)| !is_known_stranger(name))
        .collect();
    let skipped = all - tensors.len();
    let sizes = Sizes::infer(&request.weights, &tensors)?;
    let (config, statistics) = settings(request, mean, std, &sizes)?;
    let device = Device::flex();
    let model = text_denoiser(&config, sizes.channels, &device)?;
    let mut model = published::load(&request.weights, model, &tensors)?;
    if let Some(path) = &request.projection {
        let channels = sizes.channels;
        let allowed = format!("[{channels}, {channels}], the network's channels");
        let matrix = array(path, allowed, |shape| shape == [channels, channels])?;
        let emphasis = GmdConfig::of(&config)?.emphasis;
        // Rejects what cannot be undone.
        EmphasisProjection::from_matrix(&matrix, channels, emphasis.scale, &emphasis.channels)?;
        model = model.in_space_of(matrix, &device);
    }
    let (infos, values) = (parameters::infos(&model), parameters::values(&model));
    let state = State {
        format: FORMAT,
        kinegrad: env!("CARGO_PKG_VERSION").to_string(),
        step: 0,
        config: config.clone(),
        statistics,
        network_statistics: None,
        dataset_sha256: None,
        progress: Progress::default(),
        checksums: BTreeMap::new(),
    };
    Ok(Imported {
        path: write_weights(&request.out, &state, &infos, &values, &values)?,
        parameters: parameters::count(&model),
        part,
        skipped,
        config,
        warnings,
    })
}

/// The tensors of the file's averaged weights, of its last ones, or of a bare state dict, by name.
fn read_weights(
    path: &Path,
    last: bool,
) -> Result<(Option<&'static str>, BTreeMap<String, Tensor>), Error> {
    let all = read_tensors(path)?;
    let parts: [&'static str; 2] = match last {
        true => ["model", "model_avg"],
        false => ["model_avg", "model"],
    };
    let inside = |part: &'static str| {
        let inside = part_of(&all, part);
        (!inside.is_empty()).then_some((Some(part), inside))
    };
    match parts.into_iter().find_map(inside) {
        Some(found) => Ok(found),
        None => Ok((None, all)),
    }
}

/// What the shapes of the weights say of the network.
struct Sizes {
    channels: usize,
    width: usize,
    levels: Vec<usize>,
    adagn: bool,
}

impl Sizes {
    fn infer(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Error> {
        let size = |name: &str, axis: usize| {
            let shape = tensors.get(name).map(Tensor::shape);
            shape.and_then(|shape| shape.get(axis).copied())
        };
        let lacking = |name: &str| Error::Foreign {
            path: path.to_path_buf(),
            reason: format!(
                "it has no `{name}`: these are not the weights of a UNet of Guided Motion Diffusion"
            ),
        };
        let adagn_name = "unet.downs.0.0.blocks.0.block1.0.weight";
        let plain_name = "unet.downs.0.0.blocks.0.block.0.weight";
        let (output, inner) = ("unet.final_conv.1.weight", "unet.time_mlp.2.weight");
        let adagn = tensors.contains_key(adagn_name);
        let levels = (0..).map_while(|level| {
            let half = if adagn { "block1" } else { "block" };
            size(&format!("unet.downs.{level}.0.blocks.0.{half}.0.weight"), 0)
        });
        let sizes = Self {
            channels: size(output, 0).ok_or_else(|| lacking(output))?,
            width: size(inner, 0).ok_or_else(|| lacking(inner))?,
            levels: levels.collect(),
            adagn,
        };
        match sizes.levels.is_empty() || sizes.width == 0 {
            true => Err(lacking(plain_name)),
            false => Ok(sizes),
        }
    }
}

/// The config that describes the weights, and the statistics of their data.
fn settings(
    request: &ImportRequest,
    mean_path: &Path,
    std_path: &Path,
    sizes: &Sizes,
) -> Result<(Config, Statistics), Error> {
    let recipe = &request.architecture;
    let text = format!("[train]\nrecipe = \"{recipe}\"\n");
    let mut config = Systems(&[&Gmd]).parse(&text, "the recipe's defaults", &[])?;
    let (mean, std) = (vector(mean_path)?, vector(std_path)?);
    let skeleton = SkeletonName::of_channels(mean.len()).ok_or_else(|| Error::Array {
        path: mean_path.to_path_buf(),
        found: format!("{} numbers", mean.len()),
        allowed: "one for each feature: 263 of HumanML3D, 251 of KIT-ML".into(),
    })?;
    config.data.humanml3d.skeleton = skeleton;
    let channels = channels_of(&config)?;
    if channels != sizes.channels {
        return Err(Error::Foreign {
            path: request.weights.clone(),
            reason: format!(
                "it is a network of {} channels, `{recipe}` with these statistics has {channels}",
                sizes.channels
            ),
        });
    }
    config.run.name = request
        .out
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let mut own = GmdConfig::of(&config)?;
    let Backbone::GmdUnet(unet) = &mut own.model.network else {
        unreachable!("the recipe's own kind of network");
    };
    let mults: Vec<f64> = sizes
        .levels
        .iter()
        .map(|&channels| channels as f64 / sizes.width as f64)
        .collect();
    if (unet.latent_dim, &unet.dim_mults) != (sizes.width, &mults) {
        own.model.size = GmdUnetConfig::SIZES[0].0.into();
    }
    *unet = GmdUnetConfig {
        latent_dim: sizes.width,
        dim_mults: mults,
        adagn: sizes.adagn,
        padded_frames: request.padded_frames,
        ..unet.clone()
    };
    let most = config.data.target_frames.min(request.padded_frames);
    config.data.target_frames = most;
    if request.projection.is_none() {
        own.emphasis.kind = EmphasisKind::None;
    }
    let statistics = Statistics::new(mean, std, Some(Root::Absolute))?;
    config.system = own.to_table();
    Ok((config, statistics))
}
