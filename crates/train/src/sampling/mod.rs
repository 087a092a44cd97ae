//! Generating motion with a trained model: [`sample`], for the command line and other programs.

mod clip_files;
mod given;
mod record;
mod request;
mod seed;
mod style;

use std::ops::ControlFlow;

use kinegrad_motion::humanml::{Joints, Skeleton};

pub use clip_files::{BVH, FEATURES, MOTION, clip_files};
pub use given::{Given, GivenFrames, GivenMotion};
pub use record::{
    BatchRecord, CompositionRecord, Condition, GoalRecord, Kept, PathRecord, Record, RolloutRecord,
    SaidRecord, SamplerRecord, WindowsRecord,
};
pub use request::{Conditions, PathFile, Request};
pub use seed::item_seed;
pub use style::Style;

use crate::TrainedModel;
use crate::error::Error;
use crate::observer::Reading;
use crate::system::Systems;

/// Generates motion with the model of `trained` and passes each sample, with its [`Record`], to
/// `receiver`. Returns a summary of all samples.
///
/// # Errors
/// If the request contradicts itself, if the model does not support a condition or it cannot be
/// read, if the receiver fails, and [`Error::Interrupted`] if it asks to stop.
pub fn sample(
    systems: Systems<'_>,
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    request.validate()?;
    let (system, _) = systems.of(trained.config())?;
    let request = request.at(system.fps(trained.config()))?;
    system.sample(trained, &request, receiver)
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

/// Names of the samples of a request: `count` for each of the stems, numbered if there are several.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// What stands for a condition; empty if there is one.
    pub stems: Vec<String>,
    /// Samples of each.
    pub count: usize,
}

impl Names {
    /// The name of a sample of a stem, from 0.
    pub fn of(&self, stem: &str, index: usize) -> String {
        match self.count {
            1 => stem.to_string(),
            _ => format!("{stem}-{index:03}"),
        }
    }

    /// Whether a sample has that name.
    pub fn contains(&self, name: &str) -> bool {
        self.stems.iter().any(|stem| {
            let index = name.strip_prefix(stem.as_str());
            match (self.count, index) {
                (_, None) => false,
                (1, Some(rest)) => rest.is_empty(),
                (count, Some(rest)) => rest
                    .strip_prefix('-')
                    .and_then(|number| number.parse().ok())
                    .is_some_and(|index: usize| index < count && self.of(stem, index) == name),
            }
        })
    }
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

    /// Called before anything is drawn with the names of all samples and the extensions of their
    /// files.
    ///
    /// # Errors
    /// If they cannot be stored, for example because files of these names exist; nothing is drawn
    /// then.
    fn announced(&mut self, _names: &Names, _extensions: &[&str]) -> Result<(), Error> {
        Ok(())
    }

    /// Called with what the user did not say and was decided.
    fn note(&mut self, _text: &str) {}

    /// Called with what is doubtful about the request.
    fn warning(&mut self, _text: &str) {}

    /// Returns a callback for the progress of opening a dataset, as
    /// [`Observer::reading`](crate::Observer::reading).
    fn reading(&self) -> Box<Reading> {
        Box::new(|_, _| ControlFlow::Continue(()))
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbered_where_there_are_several() {
        let stems = || vec![String::new(), "-a".to_string()];
        let one = Names {
            stems: stems(),
            count: 1,
        };
        assert_eq!(one.of("-a", 0), "-a");
        assert!(one.contains("") && one.contains("-a"));
        assert!(!one.contains("-a-000") && !one.contains("-b"));
        let many = Names {
            stems: stems(),
            count: 1200,
        };
        assert_eq!(many.of("-a", 7), "-a-007");
        assert!(many.contains("-a-007") && many.contains("-1199"));
        for other in ["", "-a", "-a-7", "-1200", "-a-1200", "-a-0007", "-b-000"] {
            assert!(!many.contains(other), "{other}");
        }
    }
}
