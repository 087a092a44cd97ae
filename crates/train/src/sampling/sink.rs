//! Receivers of samples.

use std::ops::ControlFlow;

use kinegrad_motion::humanml::{Joints, Skeleton};

use super::{Names, Record};
use crate::error::Error;
use crate::observer::Reading;

/// The files of one sample.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Suffix that distinguishes the sample from others of the request; empty for a single sample.
    pub name: String,
    /// The files by extension, such as `.npy`; the first file is the motion itself.
    pub files: Vec<(&'static str, Contents)>,
    /// The record of the sample's generation.
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
    Body {
        /// Joint positions.
        joints: Joints,
        /// The skeleton.
        skeleton: Box<Skeleton>,
    },
}

/// A summary of all samples of a request.
#[derive(Clone, Debug)]
pub enum Summary {
    /// Lines of text.
    Text(String),
    /// A table whose first row is the header.
    Table(Vec<Vec<String>>),
}

/// Receives samples and progress.
pub trait SampleSink {
    /// Called after each denoising step with the steps done and in total; `stage` may be empty.
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize);

    /// Called with each sample.
    ///
    /// # Errors
    /// If the sample cannot be stored; sampling then stops.
    fn sample(&mut self, sample: Sample) -> Result<(), Error>;

    /// Called before sampling with the names of all samples and the extensions of their files.
    ///
    /// # Errors
    /// If the files cannot be stored, for example because such files exist; sampling does not
    /// start.
    fn reserve_outputs(&mut self, _names: &Names, _extensions: &[&str]) -> Result<(), Error> {
        Ok(())
    }

    /// Called with a choice that the request did not specify.
    fn note(&mut self, _text: &str) {}

    /// Called with a warning about the request.
    fn warning(&mut self, _text: &str) {}

    /// As [`Observer::reading`](crate::Observer::reading).
    fn reading(&self) -> Box<Reading> {
        Box::new(|_, _| ControlFlow::Continue(()))
    }

    /// True to stop with [`Error::Interrupted`]; called after each denoising step.
    fn stop_requested(&self) -> bool {
        false
    }

    /// [`stepped`](Self::stepped), then a check for interruption.
    fn advance(&mut self, stage: &'static str, done: usize, all: usize) -> ControlFlow<()> {
        self.stepped(stage, done, all);
        match self.stop_requested() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}
