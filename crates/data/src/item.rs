//! Items of datasets.

use std::borrow::Cow;
use std::fmt::Debug;

use kinegrad_motion::Representation;

use crate::Songs;

/// One item of a dataset: motion and its conditions.
pub trait Item: Debug + Send + Sync + 'static {
    /// Name of its kind in messages: `phrase` or `clip`.
    const KIND: &'static str;

    /// Representation of its motion.
    type Representation: Representation + Clone;

    /// Its id in the dataset.
    fn id(&self) -> &str;

    /// Number of frames.
    fn frames(&self) -> usize;

    /// Size in memory, bytes.
    fn bytes(&self) -> usize;

    /// The motion as rows of `representation`, `[frames, channels]`.
    fn rows(&self, representation: &Self::Representation) -> Cow<'_, [f32]>;

    /// The item's label, such as the dance style.
    fn label(&self) -> Option<&str> {
        None
    }

    /// Values of the conditions, by name.
    fn conditions(&self) -> Vec<(&'static str, &[f32])> {
        Vec::new()
    }

    /// Counts of the conditions, by name.
    fn counts(&self) -> Vec<(&'static str, usize)> {
        Vec::new()
    }

    /// Song of the item, and distance of its beats from the beats tracked in the music, if it has
    /// both.
    fn tracked_beats(&self, _songs: &Songs) -> Option<(String, f64)> {
        None
    }
}
