//! What datasets consist of.

use std::borrow::Cow;
use std::fmt::Debug;

use kinegrad_motion::Representation;

/// One piece of a dataset: motion, and what it is conditioned on.
pub trait Item: Debug + Send + Sync + 'static {
    /// What messages call one: `phrase` or `clip`.
    const KIND: &'static str;

    /// What its rows of numbers are.
    type Representation: Representation + Clone;

    /// Its name in the dataset.
    fn id(&self) -> &str;

    /// Number of frames.
    fn frames(&self) -> usize;

    /// Bytes it takes in memory.
    fn bytes(&self) -> usize;

    /// Its motion as rows of `representation`, `[frames, channels]`.
    fn rows(&self, representation: &Self::Representation) -> Cow<'_, [f32]>;

    /// What it is called, such as the kind of dance.
    fn label(&self) -> Option<&str> {
        None
    }

    /// Numbers of its conditions, by name.
    fn conditions(&self) -> Vec<(&'static str, &[f32])> {
        Vec::new()
    }

    /// Counts of its conditions, by name.
    fn counts(&self) -> Vec<(&'static str, usize)> {
        Vec::new()
    }
}
