//! Published PyTorch checkpoints as runs (docs/sources.md, section 4.4).

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use kinegrad_models::NetworkConfig;
use kinegrad_motion::Statistics;
use kinegrad_motion::emphasis::EmphasisKind;
use kinegrad_motion::humanml::{FeatureLayout, Root};
use kinegrad_train::checkpoint::must_be_free;
use kinegrad_train::config::{Config, OwnTables};
use kinegrad_train::import::{ImportRequest, Imported, needed, size, skeleton_of};
use kinegrad_train::published::{
    self, array, mean_and_deviation, part_of, read_tensors, without_prefix,
};
use kinegrad_train::{Error, Systems};
use pytorch_reader::Tensor;

use super::load::{channels_of, projection_of, text_denoiser};
use super::recipe_name::RecipeName;
use super::{Gmd, GmdConfig};
use crate::network::transformer::EncoderConfig;
use crate::network::{Backbone, GmdUnetConfig};

#[derive(Clone, Copy, PartialEq, Eq)]
enum Architecture {
    /// The UNet of Guided Motion Diffusion.
    Unet(RecipeName),
    /// The transformer of the Human Motion Diffusion Model.
    Mdm,
}

pub(super) const ARCHITECTURES: [&str; 3] = [
    RecipeName::Motion.name(),
    RecipeName::Trajectory.name(),
    "mdm",
];

impl Architecture {
    fn named(name: &str) -> Self {
        RecipeName::named(name).map_or(Self::Mdm, Self::Unet)
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

/// Reads published weights and writes a run with one checkpoint, for sampling and initialization.
/// Training cannot resume: the checkpoint has no optimizer state.
pub fn import(request: &ImportRequest) -> Result<Imported, Error> {
    let hint = "give option `mean M.npy` and option `std S.npy`, those that the model was trained with: for an \
                absolute root Mean_abs_3d.npy and Std_abs_3d.npy, for option `arch mdm` Mean.npy and Std.npy";
    let statistics = request.statistics(hint)?;
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
            let hint = "only the motion models of option `arch gmd_motion` use a projection";
            return Err(request.refused("projection", hint));
        }
    }
    if architecture == Architecture::Mdm {
        request.must_not_pad()?;
    }
    must_be_free(&request.out)?;
    let (part, tensors) = read_weights(&request.weights, request.last)?;
    let (tensors, skipped) = needed(tensors, &[]);
    let sizes = match architecture {
        Architecture::Unet(_) => Sizes::of_unet(request, &tensors)?,
        Architecture::Mdm => Sizes::of_mdm(request, &tensors)?,
    };
    let (config, statistics) = settings(request, architecture, statistics, &sizes)?;
    let device = Device::flex();
    let model = text_denoiser(&config, sizes.channels, &device)?;
    let mut model = published::load(&request.weights, model, &tensors)?;
    if let Some(path) = &request.projection {
        let channels = sizes.channels;
        let allowed = format!("[{channels}, {channels}], the network's channels");
        let matrix = array(path, allowed, |shape| shape == [channels, channels])?;
        // Rejects singular maps.
        projection_of(&config.own::<GmdConfig>().emphasis, &matrix, channels)?;
        model = model.in_space_of(matrix, &device);
    }
    Ok(Imported {
        part,
        skipped,
        warnings,
        ..Imported::write(request, &model, config, statistics)?
    })
}

/// Tensors by name: the file's averaged weights, its last weights, or a bare state dict.
fn read_weights(
    path: &Path,
    last: bool,
) -> Result<(Option<&'static str>, BTreeMap<String, Tensor>), Error> {
    let all = read_tensors(path)?;
    let parts = if last {
        ["model", "model_avg"]
    } else {
        ["model_avg", "model"]
    };
    let inside = |part: &'static str| {
        let inside = part_of(&all, part);
        (!inside.is_empty()).then_some((Some(part), inside))
    };
    let found = parts.into_iter().find_map(inside);
    Ok(found.unwrap_or_else(|| (None, without_prefix(all, &[UNET_OUTPUT, MDM_INPUT]))))
}

/// A tensor of each UNet.
const UNET_OUTPUT: &str = "unet.final_conv.1.weight";

/// A tensor of each encoder.
const MDM_INPUT: &str = "input_process.poseEmbedding.weight";

/// The network according to the shapes of the weights.
struct Sizes {
    channels: usize,
    /// The network, and the name of its base size.
    network: Backbone,
    size: &'static str,
}

impl Sizes {
    fn of_unet(request: &ImportRequest, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Error> {
        let size = |name: &str, axis| size(tensors, name, axis);
        let lacking = |name| request.lacking(name, "a UNet of Guided Motion Diffusion");
        let adagn_name = "unet.downs.0.0.blocks.0.block1.0.weight";
        let plain_name = "unet.downs.0.0.blocks.0.block.0.weight";
        let (output, inner) = (UNET_OUTPUT, "unet.time_mlp.2.weight");
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
        let mut network = GmdUnetConfig {
            latent_dim: width,
            dim_mults: mults.collect(),
            adagn,
            ..GmdUnetConfig::default()
        };
        if let Some(frames) = request.padded_frames {
            network.padded_frames = frames;
        }
        network.validate()?;
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

    /// The number of heads is the published model's, because no weight shape depends on the number
    /// of heads.
    fn of_mdm(request: &ImportRequest, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Error> {
        let lacking = |name| request.lacking(name, "the Human Motion Diffusion Model's encoder");
        let size = |name, axis| size(tensors, name, axis).ok_or_else(|| lacking(name));
        let layers = (0..).take_while(|layer| {
            let name = format!("seqTransEncoder.layers.{layer}.linear1.weight");
            tensors.contains_key(&name)
        });
        let network = EncoderConfig {
            latent_dim: size(MDM_INPUT, 0)?,
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

/// Smallest ratio between the standard deviations of the root's position and of its displacement
/// per frame. Walking clips and the published statistics have ratios in the tens.
const PLACES_TO_STEPS: f64 = 3.0;

/// Largest standard deviation of the displacement per frame, relative to the root's height: 9 cm,
/// nearly 2 m/s.
const LARGEST_STEP: f64 = 0.1;

/// Standard deviations of the root's ground channels and of its displacement per frame; both are
/// similar for a relative root. Other channels do not depend on the root's representation.
fn ground_and_step(std: &[f64], layout: FeatureLayout) -> [f64; 2] {
    let x = layout.velocities().start;
    [std[1].max(std[2]), std[x].max(std[x + 2])]
}

/// True for statistics of features with relative root. False also for statistics of no body, such
/// as all ones.
fn is_relative(mean: &[f64], std: &[f64], layout: FeatureLayout) -> bool {
    let [ground, step] = ground_and_step(std, layout);
    ground < PLACES_TO_STEPS * step && ground < LARGEST_STEP * mean[3].abs()
}

/// True for standard deviations of features with absolute root.
fn is_absolute(std: &[f64], layout: FeatureLayout) -> bool {
    let [ground, step] = ground_and_step(std, layout);
    ground > PLACES_TO_STEPS * step
}

/// The config that describes the weights, and the statistics of their data.
fn settings(
    request: &ImportRequest,
    architecture: Architecture,
    [mean_path, std_path]: [&Path; 2],
    sizes: &Sizes,
) -> Result<(Config, Statistics), Error> {
    let recipe = architecture.recipe().name();
    // The published programs sample the padding, and neither limit guidance nor sample again.
    let text = format!(
        "[train]\nrecipe = \"{recipe}\"\n[steering]\npadding = \"sampled\"\nmax_shift = 1e6\nattempts = 1\n\
         detours = false\n[steering.schedule]\nmotion_until = 20\n"
    );
    let mut config = Systems(&[&Gmd]).parse(&text, "the recipe's defaults", &request.overrides)?;
    let [mean, std] = mean_and_deviation(mean_path, std_path)?;
    let skeleton = skeleton_of(&mean, mean_path)?;
    let layout = skeleton.skeleton().layout();
    let refused = |found: &str, allowed: &str| Error::Array {
        path: std_path.to_path_buf(),
        found: found.into(),
        allowed: allowed.into(),
    };
    if architecture.root() == Root::Relative && is_absolute(&std, layout) {
        return Err(refused(
            "deviations of features with absolute root: the root's x and z (channels 1 and 2) vary \
             much more than its displacement to the next frame does",
            "those of features with relative root, as the Human Motion Diffusion Model was trained \
             on: Mean.npy and Std.npy, not Mean_abs_3d.npy and Std_abs_3d.npy",
        ));
    }
    if architecture.root() == Root::Absolute && is_relative(&mean, &std, layout) {
        return Err(refused(
            "deviations of features with relative root: the root's x and z (channels 1 and 2) vary \
             no more than its displacement to the next frame does",
            "those of features with absolute root, as published models of Guided Motion Diffusion \
             were trained on: Mean_abs_3d.npy and Std_abs_3d.npy, not Mean.npy and Std.npy",
        ));
    }
    config.data.humanml3d.skeleton = skeleton;
    config.data.humanml3d.root = architecture.root();
    let channels = channels_of(&config);
    if channels != sizes.channels {
        return Err(request.foreign(format!(
            "it is a network of {} channels, `{}` with these statistics has {channels}",
            sizes.channels, request.architecture
        )));
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

    /// Statistics of walks with this representation of the root.
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
        // Published deviations may be divided by the weight of the root.
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
        // Statistics of no body.
        assert!(!is_relative(&[0.0; 263], &[1.0; 263], layout));
        assert!(!is_relative(&[1.0; 263], &[1.0; 263], layout));
    }
}
