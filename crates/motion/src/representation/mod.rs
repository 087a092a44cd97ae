//! Representations of motion.
//!
//! A [`Representation`] defines channels, frame rate, normalization, joints, checks and curves.
//! Models are trained on [`Phrases`] and [`JointFeatures`]. [`JointPositions`] are an exchange
//! format.

mod joints;
mod phrases;

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::ops::Range;

pub use joints::{GroundPath, JointFeatures, JointPositions};
pub use phrases::{Phrases, phrase_statistics};

use serde::{Deserialize, Serialize};

use crate::humanml::{Joints, Skeleton};
use crate::metrics::mean_jerk;
use crate::quantiles::percentile;
use crate::sanity::body;
use crate::{ChannelMoments, Check, Profile, Report, Statistics};

/// A representation of motion. Rows are `[frames, channels]`, row-major, in the units of the
/// dataset. Rows may contain any values, including NaN, unless stated otherwise.
pub trait Representation: Debug + Send + Sync {
    /// The name, for messages.
    fn name(&self) -> String;

    /// Number of channels.
    fn channels(&self) -> usize;

    /// Number of channels of stored rows and their statistics.
    fn stored_channels(&self) -> usize {
        self.channels()
    }

    /// Frames per second.
    fn fps(&self) -> f64;

    /// The same representation at another rate; `None` if the rate is fixed.
    fn at_rate(&self, _fps: f64) -> Option<Box<dyn Representation>> {
        None
    }

    /// The shape of an array of such rows, for messages.
    fn shape(&self) -> String {
        format!("[T, {}]", self.channels())
    }

    /// Name of a channel, such as `position.x`; for messages and tables.
    fn channel_name(&self, channel: usize) -> String;

    /// Joint positions, `[frames, joints, 3]`, metres, the root first; `None` if not finite.
    fn joints(&self, rows: &[f32]) -> Option<Joints>;

    /// The skeleton of the joints, if known.
    fn skeleton(&self) -> Option<&Skeleton> {
        None
    }

    /// True if an array of this `shape` with these values is in this representation.
    fn accepts(&self, shape: &[usize], _values: &[f32]) -> bool {
        matches!(shape, [frames, channels] if *frames > 0 && *channels == self.channels())
    }

    /// Groups of channels for summaries, by name; by default one group per channel.
    fn groups(&self) -> Vec<(String, Range<usize>)> {
        let channels = 0..self.channels();
        channels.map(|c| (self.channel_name(c), c..c + 1)).collect()
    }

    /// Statistics that normalize motion with these `moments`.
    fn statistics(&self, moments: ChannelMoments) -> Statistics {
        Statistics::standard(moments)
    }

    /// Mean norm of the third derivative of position in finite rows, metres per second cubed.
    fn mean_jerk(&self, rows: &[f32]) -> f64 {
        let joints = self.joints(rows);
        let jerk = joints.and_then(|joints| mean_jerk(&joints, self.fps()));
        jerk.unwrap_or_default()
    }

    /// Measures of movement by name, of rows whose values are finite.
    fn movement(&self, _rows: &[f32]) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// The reason that finite rows cannot be in this representation, if detectable.
    fn implausible(&self, _rows: &[f32]) -> Option<String> {
        None
    }

    /// Checks of the channels themselves, of finite rows.
    fn channel_checks(&self, _rows: &[f32]) -> Vec<Check> {
        Vec::new()
    }

    /// Checks whether rows are plausible motion; `statistics` are those of training motion. Without
    /// measures of movement in them, the bounds are those of captured people.
    fn check(&self, rows: &[f32], profile: Profile, statistics: Option<&Statistics>) -> Report {
        body::check(self, rows, profile, statistics)
    }

    /// Curves to plot over time.
    fn curves(&self, rows: &[f32]) -> Vec<Curves> {
        let of = |joints| joints::curves(&joints, self.skeleton(), self.fps());
        self.joints(rows).map(of).unwrap_or_default()
    }
}

/// Time series in one chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Curves {
    /// Title with unit.
    pub title: String,
    /// Named series, `[frames]` or slightly shorter.
    pub series: Vec<(String, Vec<f64>)>,
    /// The check of the profile `ccmotion` that bounds the values.
    pub check: Option<&'static str>,
}

impl Curves {
    fn new(title: &str, series: Vec<(String, Vec<f64>)>) -> Self {
        Self {
            title: title.to_owned(),
            series,
            check: None,
        }
    }

    fn bounded_by(self, check: &'static str) -> Self {
        Self {
            check: Some(check),
            ..self
        }
    }

    /// Channels of the rows.
    fn channels(
        title: &str,
        rows: &[f32],
        width: usize,
        channels: Range<usize>,
        names: &[&str],
    ) -> Self {
        let series = channels.zip(names).map(|(channel, name)| {
            let frames = rows.chunks_exact(width);
            let values = frames.map(|frame| f64::from(frame[channel])).collect();
            ((*name).to_owned(), values)
        });
        Self::new(title, series.collect())
    }
}

/// Moments and mean jerks of items.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Measured {
    moments: ChannelMoments,
    jerks: Vec<f64>,
    /// Values of all items by measure.
    movement: BTreeMap<String, Vec<f64>>,
}

impl Measured {
    /// Measures the finite rows of one item.
    ///
    /// # Panics
    /// Panics without rows.
    pub fn of(representation: &dyn Representation, rows: &[f32]) -> Self {
        let movement = representation.movement(rows).into_iter();
        let movement = movement.map(|(name, value)| (name.to_owned(), vec![value]));
        Self {
            moments: ChannelMoments::measure(representation.channels(), [rows]),
            jerks: vec![representation.mean_jerk(rows)],
            movement: movement.collect(),
        }
    }

    /// Adds further items.
    pub fn merge(&mut self, other: Self) {
        self.moments.merge(&other.moments);
        self.jerks.extend(other.jerks);
        for (name, values) in other.movement {
            self.movement.entry(name).or_default().extend(values);
        }
    }

    /// Moments of the channels.
    pub fn moments(&self) -> &ChannelMoments {
        &self.moments
    }

    /// The statistics that normalize the motion.
    pub fn statistics(self, representation: &dyn Representation) -> Statistics {
        let extremes = |values: Vec<f64>| [1.0, 99.0].map(|p| percentile(values.clone(), p));
        let movement = self.movement.into_iter();
        Statistics {
            movement: movement
                .map(|(name, values)| (name, extremes(values)))
                .collect(),
            jerk_p95: Some(percentile(self.jerks, 95.0)),
            ..representation.statistics(self.moments)
        }
    }
}

/// The statistics of items; `None` without items.
pub fn statistics_of<'a>(
    representation: &dyn Representation,
    items: impl IntoIterator<Item = &'a [f32]>,
) -> Option<Statistics> {
    let of_item = |rows| Measured::of(representation, rows);
    let mut items = items.into_iter().map(of_item);
    let mut all = items.next()?;
    items.for_each(|measured| all.merge(measured));
    Some(all.statistics(representation))
}

/// Root mean square of the norm of a vector in `channels`.
fn root_mean_square(moments: &ChannelMoments, channels: Range<usize>) -> f64 {
    // E|v|^2 is the sum of squared means and squared deviations over the axes.
    let squares = channels.map(|c| moments.mean[c].powi(2) + moments.std[c].powi(2));
    squares.sum::<f64>().sqrt()
}
