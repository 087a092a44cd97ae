//! Importing weights of other programs: requests and results.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::module::Module;
use kinegrad_data::humanml::SkeletonName;
use kinegrad_models::parameters;
use kinegrad_motion::Statistics;
use pytorch_reader::Tensor;

use crate::checkpoint::{State, write_weights};
use crate::config::Config;
use crate::error::Error;

/// The settings of an import. A system rejects settings that its networks do not use.
#[derive(Clone, Debug)]
pub struct ImportRequest {
    /// The file that `torch.save` wrote.
    pub weights: PathBuf,
    /// One of a system's [`architectures`](crate::System::architectures).
    pub architecture: String,
    /// `.npy` file of the training data's mean, one number per channel.
    pub mean: Option<PathBuf>,
    /// `.npy` file of the training data's standard deviation.
    pub std: Option<PathBuf>,
    /// `.npy` file of a projection's matrix, for a model that works in a projected space.
    pub projection: Option<PathBuf>,
    /// Frames that the network pads every clip to, for a network that pads.
    pub padded_frames: Option<usize>,
    /// Import the weights of the last step instead of the moving average.
    pub last: bool,
    /// Settings of the new run, `KEY=VALUE`.
    pub overrides: Vec<String>,
    /// Folder of the new run.
    pub out: PathBuf,
}

impl ImportRequest {
    /// The `.npy` files of mean and deviation.
    ///
    /// # Errors
    /// [`Error::Usage`] with `hint` if one is missing.
    pub fn statistics(&self, hint: &str) -> Result<[&Path; 2], Error> {
        match (&self.mean, &self.std) {
            (Some(mean), Some(std)) => Ok([mean, std]),
            _ => {
                let message = "the statistics of the weights' training data are missing";
                Err(Error::usage(message, hint))
            }
        }
    }

    /// Checks that no number of padded frames is given, for a network that does not pad.
    ///
    /// # Errors
    /// [`Error::Usage`] if one is given.
    pub fn must_not_pad(&self) -> Result<(), Error> {
        match self.padded_frames {
            None => Ok(()),
            Some(_) => Err(self.refused("padded_frames", "only UNets pad: leave it out")),
        }
    }

    /// The error for an option that the architecture does not take.
    pub fn refused(&self, option: &str, hint: &str) -> Error {
        let message = format!("option `{option}` with option `arch {}`", self.architecture);
        Error::usage(message, hint)
    }

    /// The error for weights of another network.
    pub fn foreign(&self, reason: String) -> Error {
        Error::Foreign {
            path: self.weights.clone(),
            reason,
        }
    }

    /// The error for weights that lack the tensor `name` of `network`.
    pub fn lacking(&self, name: &str, network: &str) -> Error {
        self.foreign(format!(
            "it has no `{name}`: these are not the weights of {network}"
        ))
    }
}

/// The size of a tensor along an axis, if the tensor exists.
pub fn size(tensors: &BTreeMap<String, Tensor>, name: &str, axis: usize) -> Option<usize> {
    tensors.get(name)?.shape().get(axis).copied()
}

/// The imported run.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The checkpoint.
    pub path: PathBuf,
    /// Number of parameters.
    pub parameters: usize,
    /// The part of the file that was read; `None` for a bare state dict.
    pub part: Option<&'static str>,
    /// Number of known tensors that are not needed.
    pub skipped: usize,
    /// The resolved config.
    pub config: Config,
    /// Warnings.
    pub warnings: Vec<String>,
}

impl Imported {
    /// Writes `model` to the folder of `request`, as the only checkpoint of a run of that name.
    ///
    /// # Errors
    /// If the run cannot be written.
    pub fn write<M: Module>(
        request: &ImportRequest,
        model: &M,
        mut config: Config,
        statistics: Statistics,
    ) -> Result<Self, Error> {
        let name = request.out.file_name().unwrap_or_default();
        config.run.name = name.to_string_lossy().into_owned();
        let state = State::untrained(config.clone(), statistics);
        let (infos, values) = (parameters::infos(model), parameters::values(model));
        Ok(Self {
            path: write_weights(&request.out, &state, &infos, &values, &values)?,
            parameters: parameters::count(model),
            part: None,
            skipped: 0,
            config,
            warnings: Vec::new(),
        })
    }
}

/// The needed tensors of a file, and the number of skipped tensors. The text encoder and tables of
/// positions, which are formulas, are skipped. `tables` names more tables.
pub fn needed(
    mut tensors: BTreeMap<String, Tensor>,
    tables: &[&str],
) -> (BTreeMap<String, Tensor>, usize) {
    let positions = [
        "sequence_pos_encoder.pe",
        "embed_timestep.sequence_pos_encoder.pe",
    ];
    let all = tensors.len();
    tensors.retain(|name, _| {
        let name = &name.as_str();
        !name.starts_with("clip_model.") && !positions.contains(name) && !tables.contains(name)
    });
    let skipped = all - tensors.len();
    (tensors, skipped)
}

/// The skeleton of features with the `mean` in the file at `path`.
///
/// # Errors
/// [`Error::Array`] for a mean of other features.
pub fn skeleton_of(mean: &[f64], path: &Path) -> Result<SkeletonName, Error> {
    SkeletonName::of_channels(mean.len()).ok_or_else(|| Error::Array {
        path: path.to_path_buf(),
        found: format!("{} numbers", mean.len()),
        allowed: "one for each feature: 263 of HumanML3D, 251 of KIT-ML".into(),
    })
}
