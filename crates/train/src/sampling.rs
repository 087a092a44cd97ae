//! Generating motion with a trained model: requests and results.

use std::path::PathBuf;

use burn::tensor::Device;
use kinegrad_motion::humanml::{Joints, Skeleton};

use crate::checkpoint::Weights;
use crate::config::Config;
use crate::error::Error;

/// A trained model and the settings to sample it with.
pub struct Subject {
    /// Its checkpoint.
    pub checkpoint: PathBuf,
    /// The config of its run, with the `sampling` table to use.
    pub config: Config,
    /// Whether to use the trained weights or their moving average.
    pub weights: Weights,
    /// The device to run on, without gradients.
    pub device: Device,
    /// Whether that is the CPU, which computes in main memory.
    pub on_host: bool,
}

/// A request for samples. Systems reject conditions that their models do not support.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// The conditions.
    pub conditions: Conditions,
    /// Samples per condition.
    pub count: usize,
    /// Frames to generate.
    pub frames: Option<usize>,
    /// Seed of the noise.
    pub seed: u64,
}

/// The sources of conditions.
#[derive(Clone, Debug, Default)]
pub struct Conditions {
    /// Dataset that contains the item, instead of the run's own.
    pub source: Option<String>,
    /// Id of the item, or a pattern.
    pub item: Option<String>,
    /// File of audio features.
    pub audio_features: Option<PathBuf>,
    /// Song.
    pub song: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts.
    pub start: f64,
    /// Goal files.
    pub goals: Vec<PathBuf>,
    /// Checkpoint of the trajectory model that generates the ground path in a first stage.
    pub trajectory: Option<PathBuf>,
    /// Text embedding, `FILE#KEY`.
    pub text_embedding: Option<String>,
    /// Use the first so many held-out items of the run's own dataset.
    pub held_out: Option<usize>,
}

impl Conditions {
    /// Rejects conditions that are set but listed in `unknown`, by their command-line names.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first that is set.
    pub fn refuse(&self, unknown: &[&str], why: &str, hint: &str) -> Result<(), Error> {
        let given = [
            ("--source", self.source.is_some()),
            ("--phrase", self.item.is_some()),
            ("--cond", self.audio_features.is_some()),
            ("--audio", self.song.is_some()),
            ("--goal", !self.goals.is_empty()),
            ("--trajectory-run", self.trajectory.is_some()),
            ("--text-embedding", self.text_embedding.is_some()),
        ];
        let mut given = given.into_iter();
        match given.find(|(name, given)| *given && unknown.contains(name)) {
            Some((name, _)) => Err(Error::usage(format!("`{name}` with {why}"), hint)),
            None => Ok(()),
        }
    }
}

/// One sample, as files.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Suffix that distinguishes it from other samples of the request; empty for a single sample.
    pub name: String,
    /// Its files by extension, such as `.npy`; the first is the motion itself.
    pub files: Vec<(&'static str, Contents)>,
}

/// Contents of a file.
#[derive(Clone, Debug)]
pub enum Contents {
    /// A row-major float32 array.
    Array {
        /// Shape.
        shape: Vec<usize>,
        /// Values.
        values: Vec<f32>,
    },
    /// An animated skeleton, written as BVH.
    Figure {
        /// Joint positions.
        joints: Joints,
        /// The skeleton.
        skeleton: Box<Skeleton>,
    },
}

/// A summary of all samples of a request.
#[derive(Clone, Debug)]
pub enum Remark {
    /// Lines of text.
    Text(String),
    /// A table whose first row is the header.
    Table(Vec<Vec<String>>),
}

/// Receives samples and progress.
pub trait Receiver {
    /// Called after each denoising step with the number of steps done and in total; `stage` is
    /// empty if there is only one.
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize);

    /// Called with each sample.
    ///
    /// # Errors
    /// If it cannot be stored; sampling stops then.
    fn drawn(&mut self, drawn: Drawn) -> Result<(), Error>;
}
