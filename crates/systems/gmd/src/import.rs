//! Published PyTorch checkpoints as runs (docs/sources.md, section 4.4).

use std::collections::BTreeMap;
use std::path::Path;

use crate::network::Backbone;
use crate::network::GmdUnetConfig;
use crate::network::transformer::EncoderConfig;
use burn::tensor::Device;
use kinegrad_models::NetworkConfig;
use kinegrad_motion::Statistics;
use kinegrad_motion::emphasis::{EmphasisKind, EmphasisProjection};
use kinegrad_motion::humanml::{FeatureLayout, Root};
use pytorch_reader::Tensor;

use super::load::{channels_of, text_denoiser};
use super::recipe_name::RecipeName;
use super::{Gmd, GmdConfig};
use kinegrad_train::Error;
use kinegrad_train::Systems;
use kinegrad_train::checkpoint::must_be_free;
use kinegrad_train::config::{Config, OwnTables};
use kinegrad_train::import::{ImportRequest, Imported, needed, skeleton_of};
use kinegrad_train::published::{self, array, mean_and_deviation, part_of, read_tensors};

/// Names of the published programs that are no weights of the network: the text encoder and the
/// tables of positions.
fn is_known_stranger(name: &str) -> bool {
    name.starts_with("clip_model.")
        || name == "sequence_pos_encoder.pe"
        || name == "embed_timestep.sequence_pos_encoder.pe"
}

/// The architecture of the weights.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Architecture {
    /// A UNet of Guided Motion Diffusion.
    Unet(RecipeName),
    /// The transformer of the Human Motion Diffusion Model, trained on features with a relative
    /// root.
    Mdm,
}

/// The name of [`Architecture::Mdm`].
const MDM: &str = "mdm";

/// Names of the architectures that [`import`] knows.
pub(super) const ARCHITECTURES: [&str; 3] = [
    RecipeName::Motion.name(),
    RecipeName::Trajectory.name(),
    MDM,
];

impl Architecture {
    fn named(name: &str) -> Self {
        match RecipeName::named(name) {
            Some(recipe) => Self::Unet(recipe),
            None => Self::Mdm,
        }
    }

    fn recipe(self) -> RecipeName {
        match self {
            Self::Unet(recipe) => recipe,
            Self::Mdm => RecipeName::Motion,
        }
    }

    fn root(self) -> Root {
        match self {
            Self::Unet(_) => Root::Absolute,
            Self::Mdm => Root::Relative,
        }
    }
}

/// Reads published weights and writes them as the only checkpoint of a run, for sampling and
/// initialisation; it has no optimiser to resume with.
///
/// # Errors
/// If a file cannot be read, a parameter is missing, superfluous, of another shape or not finite
/// (all of them are listed), or statistics or matrix do not fit. Nothing is written then.
pub fn import(request: &ImportRequest) -> Result<Imported, Error> {
    let (Some(mean), Some(std)) = (&request.mean, &request.std) else {
        let message = "the statistics of the weights' training data are missing";
        let hint = "give option `mean M.npy` and option `std S.npy`, those that the model was trained with: for an \
                    absolute root Mean_abs_3d.npy and Std_abs_3d.npy, for option `arch mdm` Mean.npy and \
                    Std.npy";
        return Err(Error::usage(message, hint));
    };
    let architecture = Architecture::named(&request.architecture);
    let mut warnings = Vec::new();
    match (architecture, &request.projection) {
        (Architecture::Unet(RecipeName::Motion), None) => warnings.push(
            "no option `projection`: published motion models work in a projected space and do not work \
             without their projection matrix"
                .to_string(),
        ),
        (Architecture::Unet(RecipeName::Motion), Some(_)) | (_, None) => {}
        (_, Some(_)) => {
            let message = format!("option `projection` with option `arch {}`", request.architecture);
            let hint = "only the motion models of option `arch gmd_motion` use a projection";
            return Err(Error::usage(message, hint));
        }
    }
    must_be_free(&request.out)?;
    let (part, tensors) = read_weights(&request.weights, request.last)?;
    let (tensors, skipped) = needed(tensors, is_known_stranger);
    let sizes = match architecture {
        Architecture::Unet(_) => Sizes::of_unet(&request.weights, &tensors, request.padded_frames)?,
        Architecture::Mdm => Sizes::of_mdm(&request.weights, &tensors)?,
    };
    let (config, statistics) = settings(request, architecture, mean, std, &sizes)?;
    let device = Device::flex();
    let model = text_denoiser(&config, sizes.channels, &device)?;
    let mut model = published::load(&request.weights, model, &tensors)?;
    if let Some(path) = &request.projection {
        let channels = sizes.channels;
        let allowed = format!("[{channels}, {channels}], the network's channels");
        let matrix = array(path, allowed, |shape| shape == [channels, channels])?;
        let emphasis = config.own::<GmdConfig>().emphasis.clone();
        // Rejects singular maps.
        EmphasisProjection::from_matrix(&matrix, channels, emphasis.scale, &emphasis.channels)?;
        model = model.in_space_of(matrix, &device);
    }
    Ok(Imported {
        part,
        skipped,
        warnings,
        ..Imported::write(request, &model, config, statistics)?
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

/// The network according to the shapes of the weights.
struct Sizes {
    channels: usize,
    /// The network, and the name of the size that its keys start from.
    network: Backbone,
    size: &'static str,
}

/// The size of a tensor along an axis, if it is there.
fn size(tensors: &BTreeMap<String, Tensor>, name: &str, axis: usize) -> Option<usize> {
    let shape = tensors.get(name).map(Tensor::shape);
    shape.and_then(|shape| shape.get(axis).copied())
}

/// The error of weights without a tensor from which the sizes follow.
fn lacking(path: &Path, name: &str, what: &str) -> Error {
    Error::Foreign {
        path: path.to_path_buf(),
        reason: format!("it has no `{name}`: these are not the weights of {what}"),
    }
}

impl Sizes {
    fn of_unet(
        path: &Path,
        tensors: &BTreeMap<String, Tensor>,
        padded_frames: usize,
    ) -> Result<Self, Error> {
        let size = |name: &str, axis| size(tensors, name, axis);
        let lacking = |name| lacking(path, name, "a UNet of Guided Motion Diffusion");
        let adagn_name = "unet.downs.0.0.blocks.0.block1.0.weight";
        let plain_name = "unet.downs.0.0.blocks.0.block.0.weight";
        let (output, inner) = ("unet.final_conv.1.weight", "unet.time_mlp.2.weight");
        let adagn = tensors.contains_key(adagn_name);
        let levels = (0..).map_while(|level| {
            let half = if adagn { "block1" } else { "block" };
            size(&format!("unet.downs.{level}.0.blocks.0.{half}.0.weight"), 0)
        });
        let levels: Vec<usize> = levels.collect();
        let channels = size(output, 0).ok_or_else(|| lacking(output))?;
        let width = size(inner, 0).ok_or_else(|| lacking(inner))?;
        if levels.is_empty() || width == 0 {
            return Err(lacking(plain_name));
        }
        let mults = levels.iter().map(|&level| level as f64 / width as f64);
        let network = GmdUnetConfig {
            latent_dim: width,
            dim_mults: mults.collect(),
            adagn,
            padded_frames,
            ..GmdUnetConfig::default()
        };
        let known = GmdUnetConfig::SIZES.iter().find(|(_, of_size)| {
            let of_size = of_size();
            (of_size.latent_dim, &of_size.dim_mults) == (width, &network.dim_mults)
        });
        Ok(Self {
            channels,
            size: known.unwrap_or(&GmdUnetConfig::SIZES[0]).0,
            network: Backbone::GmdUnet(network),
        })
    }

    /// The number of heads is that of the published model: no shape depends on it.
    fn of_mdm(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Error> {
        let lacking = |name| lacking(path, name, "the Human Motion Diffusion Model's encoder");
        let size = |name, axis| size(tensors, name, axis).ok_or_else(|| lacking(name));
        let layers = (0..).take_while(|layer| {
            let name = format!("seqTransEncoder.layers.{layer}.linear1.weight");
            tensors.contains_key(&name)
        });
        let network = EncoderConfig {
            latent_dim: size("input_process.poseEmbedding.weight", 0)?,
            num_layers: layers.count(),
            ff_size: size("seqTransEncoder.layers.0.linear1.weight", 0)?,
            ..EncoderConfig::mdm()
        };
        network.validate()?;
        Ok(Self {
            channels: size("output_process.poseFinal.weight", 0)?,
            size: EncoderConfig::SIZES[0].0,
            network: Backbone::MdmTransformer(network),
        })
    }
}

/// The root's place varies at least so many times as much as its displacement to the next frame:
/// tens of times in clips that walk, as often in the published statistics, where both may be divided
/// by a factor (5) that weights the root.
const PLACES_TO_STEPS: f64 = 3.0;

/// Part of the root's height that its displacement to the next frame varies by at most; in metres a
/// deviation of 9 cm a frame, nearly 2 m/s.
const LARGEST_STEP: f64 = 0.1;

/// True if mean and deviation are those of features with relative root, whose channels 1 and 2 are
/// displacements like those of joint 0. Statistics of both readings differ in the first three
/// channels only. Undecided for statistics of no body, such as all ones.
fn is_relative(mean: &[f64], std: &[f64], layout: FeatureLayout) -> bool {
    let displacement = layout.velocities().start;
    let ground = std[1].max(std[2]);
    let step = std[displacement].max(std[displacement + 2]);
    ground < PLACES_TO_STEPS * step && ground < LARGEST_STEP * mean[3].abs()
}

/// True if the deviation is that of features with absolute root, whose position varies far more
/// than its displacement.
fn is_absolute(std: &[f64], layout: FeatureLayout) -> bool {
    let displacement = layout.velocities().start;
    let step = std[displacement].max(std[displacement + 2]);
    std[1].max(std[2]) > PLACES_TO_STEPS * step
}

/// The config that describes the weights, and the statistics of their data.
fn settings(
    request: &ImportRequest,
    architecture: Architecture,
    mean_path: &Path,
    std_path: &Path,
    sizes: &Sizes,
) -> Result<(Config, Statistics), Error> {
    let recipe = architecture.recipe().name();
    // The published programs sample the padding.
    let text = format!("[train]\nrecipe = \"{recipe}\"\n[steering]\npadding = \"drawn\"\n");
    let mut config = Systems(&[&Gmd]).parse(&text, "the recipe's defaults", &request.overrides)?;
    let [mean, std] = mean_and_deviation(mean_path, std_path)?;
    let skeleton = skeleton_of(&mean, mean_path)?;
    let layout = skeleton.skeleton().layout();
    if architecture.root() == Root::Relative && is_absolute(&std, layout) {
        return Err(Error::Array {
            path: std_path.to_path_buf(),
            found: "deviations of features with absolute root: the root's x and z (channels 1 and 2) vary \
                    much more than its displacement to the next frame does"
                .into(),
            allowed: "those of features with relative root, as the Human Motion Diffusion Model was trained \
                      on: Mean.npy and Std.npy, not Mean_abs_3d.npy and Std_abs_3d.npy"
                .into(),
        });
    }
    if architecture.root() == Root::Absolute && is_relative(&mean, &std, layout) {
        return Err(Error::Array {
            path: std_path.to_path_buf(),
            found: "deviations of features with relative root: the root's x and z (channels 1 and \
                    2) vary no more than its displacement to the next frame does"
                .into(),
            allowed: "those of features with absolute root, as published models of Guided Motion \
                      Diffusion were trained on: Mean_abs_3d.npy and Std_abs_3d.npy, not Mean.npy \
                      and Std.npy"
                .into(),
        });
    }
    config.data.humanml3d.skeleton = skeleton;
    config.data.humanml3d.root = architecture.root();
    let channels = channels_of(&config);
    if channels != sizes.channels {
        return Err(Error::Foreign {
            path: request.weights.clone(),
            reason: format!(
                "it is a network of {} channels, `{}` with these statistics has {channels}",
                sizes.channels, request.architecture
            ),
        });
    }
    let mut own = config.own::<GmdConfig>().clone();
    own.model.size = sizes.size.into();
    own.model.network = sizes.network.clone();
    if let Some(most) = sizes.network.longest() {
        config.data.target_frames = config.data.target_frames.min(most);
    }
    if request.projection.is_none() {
        own.emphasis.kind = EmphasisKind::None;
    }
    let statistics = Statistics::new(mean, std, Some(architecture.root()))?;
    config.system = OwnTables::new(own);
    Ok((config, statistics))
}

#[cfg(test)]
mod tests {
    use kinegrad_data::humanml::Clip;
    use kinegrad_data::{DataConfig, DataKind, Dataset};

    use super::*;

    /// Statistics of walks whose root is read so.
    fn walks(root: Root) -> Statistics {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            ..DataConfig::default()
        };
        config.synthetic.phrases = 9;
        config.synthetic.frames = 60;
        config.humanml3d.root = root;
        Dataset::<Clip>::open(&config)
            .unwrap()
            .statistics()
            .unwrap()
    }

    #[test]
    fn statistics_of_relative_and_absolute_roots_are_distinguished() {
        let layout = FeatureLayout::of_channels(263).unwrap();
        let [relative, absolute] = [Root::Relative, Root::Absolute].map(walks);
        assert_eq!(relative.mean[3..], absolute.mean[3..]);
        // Both may be divided by the published weight of the root.
        for factor in [1.0, 5.0] {
            let found = |statistics: &Statistics| {
                let mut std = statistics.std.clone();
                std[..4].iter_mut().for_each(|value| *value /= factor);
                is_relative(&statistics.mean, &std, layout)
            };
            assert!(found(&relative), "{factor}: {:?}", &relative.std[..4]);
            assert!(!found(&absolute), "{factor}: {:?}", &absolute.std[..4]);
        }
        assert!(is_absolute(&absolute.std, layout));
        assert!(!is_absolute(&relative.std, layout));
        assert!(!is_absolute(&[1.0; 263], layout));
        // Of no body.
        assert!(!is_relative(&[0.0; 263], &[1.0; 263], layout));
        assert!(!is_relative(&[1.0; 263], &[1.0; 263], layout));
    }
}
