//! Phrases of motion and music: reading, checking, splitting, batching, making up.
//!
//! A dataset is a folder with `motion/ID/trajectory.npy` (`[frames, 25]`) and
//! `audio_features/ID/features.npz` (six arrays, stacked to `[163, frames]`), the layout of the
//! CC-MotionGen documentation, section 1.3. This crate knows no tensors: batches are host arrays.
//!
//! ```
//! use std::sync::Arc;
//! use kinegrad_data::{DataConfig, DataKind, Dataset, Loader};
//! use kinegrad_motion::TrainingStatistics;
//!
//! let config = DataConfig { kind: DataKind::Synthetic, batch_size: 4, ..DataConfig::default() };
//! let dataset = Dataset::open(&config)?;
//! let motions = dataset.train.iter().map(|phrase| &phrase.motion);
//! let statistics = Arc::new(TrainingStatistics::compute(motions).expect("a training phrase"));
//! let mut loader = Loader::new(dataset.train.clone(), statistics, &config, 7, 0);
//! assert_eq!(loader.next().x_start.len(), 4 * 25 * 120);
//! # Ok::<(), kinegrad_data::Error>(())
//! ```

mod atomic;
mod augment;
mod batch;
mod config;
mod dataset;
mod error;
mod features;
mod inspect;
mod loader;
mod npy;
mod npz;
mod order;
mod passage;
mod phrase;
mod prefetch;
mod source;
mod split;
mod summary;
pub mod synthetic;

pub use batch::{Batch, collate_validation};
pub use config::{
    AugmentConfig, Crop, DataConfig, DataKind, MIN_FRAMES, OnBadPhrase, SyntheticConfig,
    ValidationSplit,
};
pub use dataset::Dataset;
pub use error::{Error, FileError};
pub use features::{AUDIO_CHANNELS, AudioFeatures, FEATURES, audio_channel_name};
pub use inspect::{Inspection, Problem, inspect};
pub use loader::Loader;
pub use npy::{MAX_FRAMES, read_motion, write_motion};
pub use npz::{read_features, write_features};
pub use phrase::{Phrase, load_audio, load_phrase};
pub use source::local_folder;
pub use split::matches;
pub use summary::ChannelSummary;
