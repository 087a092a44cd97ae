//! Requests for samples.
//!
//! A [`Request`] lists [conditions](Condition). The model's system resolves a request to a
//! [`Sampler`]. [`Systems::sample`](crate::system::Systems::sample) rejects conditions that the
//! recipe does not accept, checks memory, and names and records the samples.

mod best_of;
mod condition;
mod generated;
mod ground;
mod job;
mod known_frames;
mod measures;
mod names;
mod record;
mod request;
mod seed;
mod sink;
mod style;

pub(crate) use best_of::Selection;
pub use best_of::{BestOf, SelectBy, SelectionRecord};
pub use condition::{
    Condition, GoalCondition, KnownFramesCondition, OtherCondition, PathFile, TrajectoryCondition,
};
pub use generated::Generated;
pub use ground::GroundRecord;
pub(crate) use job::TextMatch;
pub use job::{Job, Needs, Run, Sampler};
pub use known_frames::KnownFrames;
pub use measures::{MeasureRecord, MeasuresRecord};
pub use names::Names;
pub use record::{
    BatchRecord, CompositionRecord, GoalRecord, PathRecord, PromptRecord, Record, RolloutRecord,
    SamplerRecord, WindowsRecord,
};
pub use request::Request;
pub use seed::item_seed;
pub use sink::{Contents, Sample, SampleSink, Summary};
pub use style::Style;
