//! Drawing motion from a trained model: what a system is asked, and what it gives.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use kinegrad_motion::humanml::{Joints, Skeleton};

use crate::checkpoint::{State, Weights};
use crate::config::{self, Config};
use crate::error::Error;
use crate::systems::Systems;

/// A trained model, and how to draw from it.
pub struct Subject {
    /// Its checkpoint.
    pub checkpoint: PathBuf,
    /// The config of its run, with the `sampling` that draws are made by.
    pub config: Config,
    /// Which weights.
    pub weights: Weights,
    /// Where it runs, without gradients.
    pub device: Device,
}

impl Subject {
    /// The model of the checkpoint in `path`, with `overrides` of its run's tables
    /// `sampling` and `evaluation`, on `device` or else on that of its run.
    ///
    /// # Errors
    /// If the checkpoint is damaged, an override is wrong, or the device cannot be used.
    pub fn open(
        systems: Systems<'_>,
        path: &Path,
        overrides: &[String],
        weights: Weights,
        device: Option<&str>,
    ) -> Result<Self, Error> {
        let saved = systems.completed(&State::read(path)?.config)?;
        let config = config::override_trained(systems, &saved, overrides)?;
        let (system, _) = systems.of(&config)?;
        system.validate(&config)?;
        let (device, _) = crate::device::open(device.unwrap_or(&config.run.device))?;
        Ok(Self {
            checkpoint: path.to_path_buf(),
            config,
            weights,
            device,
        })
    }
}

/// What motion is asked for. A system refuses what its models cannot be told.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// What the motion is drawn under.
    pub conditions: Conditions,
    /// Samples of each condition.
    pub count: usize,
    /// Frames to draw.
    pub frames: Option<usize>,
    /// Seed of the noise.
    pub seed: u64,
}

/// Where conditions come from.
#[derive(Clone, Debug, Default)]
pub struct Conditions {
    /// Dataset whose items are drawn for, in place of the run's own.
    pub source: Option<String>,
    /// Id of the item, or a pattern.
    pub item: Option<String>,
    /// File of audio features.
    pub audio_features: Option<PathBuf>,
    /// Song.
    pub song: Option<PathBuf>,
    /// Seconds into the song at which the motion begins.
    pub start: f64,
    /// Files of goals.
    pub goals: Vec<PathBuf>,
    /// Checkpoint of the model that draws the ground path to the goal first.
    pub trajectory: Option<PathBuf>,
    /// File of a text's embedding, `FILE#KEY`.
    pub text_embedding: Option<String>,
    /// Draw for the first so many held-out items of the run's own dataset.
    pub held_out: Option<usize>,
}

impl Conditions {
    /// Refuses what is set of `unknown`, given by the names of the command line.
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

/// One motion, as files.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// What tells it from others of the same request; empty where there are none.
    pub name: String,
    /// Its files by their endings, such as `.npy`; the first is the motion itself.
    pub files: Vec<(&'static str, Contents)>,
}

/// What a file holds.
#[derive(Clone, Debug)]
pub enum Contents {
    /// Single-precision numbers, row by row.
    Array {
        /// Sizes.
        shape: Vec<usize>,
        /// The numbers.
        values: Vec<f32>,
    },
    /// A body that moves, for other programs.
    Figure {
        /// Places of its joints.
        joints: Joints,
        /// What they are the joints of.
        skeleton: Box<Skeleton>,
    },
}

/// What is to be said of all motions of a request.
#[derive(Clone, Debug)]
pub enum Remark {
    /// Lines of text.
    Text(String),
    /// A table, the first row being its header.
    Table(Vec<Vec<String>>),
}

/// Who asked for motion.
pub trait Receiver {
    /// So many denoising steps of so many are done, in a stage if there are several.
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize);

    /// A motion has been drawn.
    ///
    /// # Errors
    /// If it cannot be kept; nothing more is drawn then.
    fn drawn(&mut self, drawn: Drawn) -> Result<(), Error>;
}
