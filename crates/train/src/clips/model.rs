//! The networks of runs on clips: built from a config, read from a checkpoint, started from one.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use kinegrad_models::{Initializer, TextDenoiser, parameters};
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::humanml::FeatureStatistics;
use toml::Table;

use crate::checkpoint::{State, Weights, read_weights};
use crate::config::{Config, Recipe};
use crate::error::Error;
use crate::generate::resolve_checkpoint;
use crate::recipes::gmd_motion::TRAJECTORY_CHANNELS;
use crate::start::{clip_tables_of, must_agree, refused, values};

/// Parameter of the matrix of a projected space.
pub(super) const MATRIX: &str = "projection.matrix";

/// Channels that the networks of a run of `config` take and give.
pub fn clip_channels(config: &Config) -> usize {
    match config.train.recipe {
        Recipe::GmdTrajectory => TRAJECTORY_CHANNELS,
        _ => config
            .data
            .humanml3d
            .skeleton
            .skeleton()
            .layout()
            .channels(),
    }
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
    let backbone = config.model.backbone(channels)?;
    let init = Initializer::new(config.run.seed, device);
    Ok(TextDenoiser::new(&backbone, &init)?)
}

/// [`text_denoiser`] in the space that `emphasis` of the config makes.
///
/// # Errors
/// If it cannot be built.
pub fn model_in_space(config: &Config, device: &Device) -> Result<TextDenoiser, Error> {
    let channels = clip_channels(config);
    let model = text_denoiser(config, channels, device)?;
    let projection = match config.train.recipe {
        Recipe::GmdTrajectory => None,
        _ => config.emphasis.projection(channels)?,
    };
    Ok(match projection {
        Some(projection) => in_space_of(model, projection.matrix().to_vec(), device),
        None => model,
    })
}

pub(super) fn in_space_of(model: TextDenoiser, matrix: Vec<f32>, device: &Device) -> TextDenoiser {
    let channels = matrix.len().isqrt();
    let init = Initializer::new(0, device);
    model.in_space_of(matrix, channels, &init)
}

/// A trained denoiser of clips.
pub struct TrainedClips {
    /// The network.
    pub model: TextDenoiser,
    /// The space it works in, where that is a projected one.
    pub projection: Option<EmphasisProjection>,
    /// Statistics of its training clips.
    pub statistics: FeatureStatistics,
    /// Config, step.
    pub state: State,
}

impl TrainedClips {
    /// Loads the checkpoint in `path` onto `device`.
    ///
    /// # Errors
    /// If the checkpoint is damaged, is not of a recipe on clips, or does not fit its own config.
    pub fn load(path: &Path, weights: Weights, device: &Device) -> Result<Self, Error> {
        let state = State::read(path)?;
        if !state.config.train.recipe.reads_clips() {
            return Err(Error::NotClips);
        }
        let values = read_weights(path, &state, weights)?;
        let channels = clip_channels(&state.config);
        let mut model = text_denoiser(&state.config, channels, device)?;
        // The stored matrix counts, whatever the config would make today.
        let matrix = values.iter().find(|p| p.info.name == MATRIX);
        let projection = match matrix {
            Some(matrix) => {
                let emphasis = &state.config.emphasis;
                let projection = EmphasisProjection::from_matrix(
                    &matrix.values,
                    channels,
                    emphasis.scale,
                    &emphasis.channels,
                )?;
                model = in_space_of(model, matrix.values.clone(), device);
                Some(projection)
            }
            None => None,
        };
        Ok(Self {
            model: parameters::load(model, values)?,
            projection,
            statistics: state.statistics.features()?.clone(),
            state,
        })
    }
}

/// The checkpoint that `init.diffusion` names, for a run on clips.
pub(crate) struct ClipStart(PathBuf);

impl ClipStart {
    /// The start of `config`; none where the key is empty.
    ///
    /// # Errors
    /// If it is not there.
    pub fn named(config: &Config) -> Result<Option<Self>, Error> {
        let path = &config.init.diffusion;
        if path.as_os_str().is_empty() {
            return Ok(None);
        }
        let found = resolve_checkpoint(path, |_| {});
        let found = found.map_err(|error| refused("init.diffusion", path, &error))?;
        Ok(Some(Self(found)))
    }

    /// The statistics that the start's clips were normalised by.
    ///
    /// # Errors
    /// If the checkpoint is damaged or is not of a recipe on clips.
    pub fn statistics(&self) -> Result<FeatureStatistics, Error> {
        Ok(State::read(&self.0)?.statistics.features()?.clone())
    }

    /// What the start's config says of network, process and space: it stands beneath the new one.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn tables(&self) -> Result<Table, Error> {
        Ok(clip_tables_of(&State::read(&self.0)?.config))
    }

    /// The start's averaged weights, in its space, on an autodiff device.
    ///
    /// # Errors
    /// Names the key in which the start differs from `config`.
    pub fn model(&self, config: &Config, device: &Device) -> Result<TextDenoiser, Error> {
        let start = TrainedClips::load(&self.0, Weights::Ema, device)
            .map_err(|error| refused("init.diffusion", &self.0, &error))?;
        let (given, recipe) = (config.train.recipe, start.state.config.train.recipe);
        if given != recipe {
            let reason = format!("its recipe is `{}`, not `{}`", recipe.name(), given.name());
            return Err(refused("init.diffusion", &self.0, &reason));
        }
        let base = &start.state.config;
        must_agree(config, base, &["model", "diffusion", "emphasis"])?;
        let (given, found) = (&config.data.humanml3d, &base.data.humanml3d);
        if (given.root, given.skeleton) != (found.root, found.skeleton) {
            let reason = "its clips have another `data.humanml3d.root` or `skeleton`";
            return Err(refused("init.diffusion", &self.0, &reason));
        }
        let fresh = text_denoiser(config, clip_channels(config), device)?;
        let fresh = match &start.projection {
            Some(projection) => in_space_of(fresh, projection.matrix().to_vec(), device),
            None => fresh,
        };
        Ok(parameters::replace(fresh, values(&start.model)))
    }
}
