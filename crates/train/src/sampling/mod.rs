//! Generating motion with a trained model: [`sample`], for the command line and other programs.

mod record;
mod request;

use std::ops::ControlFlow;
use std::path::PathBuf;

use burn::tensor::Device;
use kinegrad_motion::humanml::{Joints, Skeleton};

pub use record::{Condition, Record, SamplerRecord};
pub use request::{Conditions, Request};

use crate::checkpoint::Weights;
use crate::config::Config;
use crate::error::Error;
use crate::system::Systems;

/// A trained model and the settings to sample it with.
pub struct Subject {
    /// Its checkpoint.
    pub checkpoint: PathBuf,
    /// Steps it was trained for.
    pub step: u64,
    /// The config of its run, with the `sampling` table to use.
    pub config: Config,
    /// Whether to use the trained weights or their moving average.
    pub weights: Weights,
    /// The device to run on, without gradients.
    pub device: Device,
    /// Whether that is the CPU, which computes in main memory.
    pub on_host: bool,
}

/// Generates motion with the model of `subject` and passes each sample, with its [`Record`], to
/// `receiver`. Returns a summary of all samples.
///
/// # Errors
/// If the request contradicts itself, if the model does not support a condition or it cannot be
/// read, if the receiver fails, and [`Error::Interrupted`] if it asks to stop.
pub fn sample(
    systems: Systems<'_>,
    subject: &Subject,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    request.validate()?;
    let (system, _) = systems.of(&subject.config)?;
    system.sample(subject, request, receiver)
}

/// One sample, as files.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Suffix that distinguishes it from other samples of the request; empty for a single sample.
    pub name: String,
    /// Its files by extension, such as `.npy`; the first is the motion itself.
    pub files: Vec<(&'static str, Contents)>,
    /// How it was made.
    pub record: Record,
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

    /// Called with what the user did not say and was decided.
    fn note(&mut self, _text: &str) {}

    /// Called with what is doubtful about the request.
    fn warning(&mut self, _text: &str) {}

    /// Whether to stop, asked after each denoising step. Sampling ends with
    /// [`Error::Interrupted`] then.
    fn stop_requested(&self) -> bool {
        false
    }

    /// [`stepped`](Self::stepped), and whether to go on.
    fn advance(&mut self, stage: &'static str, done: usize, all: usize) -> ControlFlow<()> {
        self.stepped(stage, done, all);
        match self.stop_requested() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}
