//! Datasets of motion: reading, validation, splits, loading and synthesis.
//!
//! A phrase dataset is a folder, a bucket or a path on a web server with `motion/ID/trajectory.npy`
//! (`[frames, 25]`) and `audio_features/ID/features.npz` (six arrays, stacked to `[163, frames]`),
//! as in CC-MotionGen, section 1.3 (docs/sources.md, section 1.1). Clips in the HumanML3D layout
//! are in [`humanml`]. [`Dataset`] and [`Loader`] support both. Batches are host arrays.
//!
//! ```
//! use std::sync::Arc;
//! use kinegrad_data::{DataConfig, DataKind, Dataset, Loader, PhraseSamples};
//!
//! let config = DataConfig { kind: DataKind::Synthetic, batch_size: 4, ..DataConfig::default() };
//! let dataset = Dataset::open(&config)?;
//! let statistics = Arc::new(dataset.statistics()?);
//! let samples = PhraseSamples::new(dataset.train, statistics, &config, 7);
//! let mut loader = Loader::new(samples, &config, 7, 0);
//! assert_eq!(loader.next()?.x_start.len(), 4 * 25 * 120);
//! # Ok::<(), kinegrad_data::Error>(())
//! ```

mod atomic;
mod audio_layout;
mod augment;
mod batch;
mod beat_agreement;
mod beat_phrase;
mod cache;
mod config;
mod context_window;
mod counters;
mod dataset;
mod digest;
mod error;
mod features;
pub mod file;
mod files;
pub mod humanml;
mod inspect;
mod item;
mod item_set;
mod item_store;
mod labels;
mod layout;
mod listing;
mod loader;
mod location;
mod magnitude;
pub mod manifest;
mod npy;
mod npz;
mod order;
mod pattern;
mod phrase_item;
mod phrase_samples;
mod phrase_set;
mod prefetch;
mod progress;
mod scan;
mod songs;
mod split;
mod store;
mod style_conditions;
pub mod synthetic;
mod time_stretch;

pub use kinegrad_motion::MAX_FRAMES;
pub use kinegrad_ranks::Alone;

pub use atomic::write as write_whole;
pub use audio_layout::{AUDIO_CHANNELS, AudioGroup, AudioLayout, check_groups};
pub use batch::{AUDIO, Batch, CAPTIONS, Condition, ConditionRows, SampleShape, TEXT, WORDS};
pub use beat_agreement::{BeatAgreement, CHANCE, tracked_error};
pub use beat_phrase::{BeatPhrase, bars};
pub use config::{
    AugmentConfig, CacheConfig, Crop, DataConfig, DataKind, MIN_FRAMES, OnBadPhrase, StatisticsOf,
    StoreConfig, SyntheticConfig, ValidationSplit,
};
pub use counters::{Counters, LoaderReport};
pub use dataset::Dataset;
pub use digest::Digest;
pub use error::{Error, FileError};
pub use features::{AudioFeatures, BEATS, FEATURES, audio_channel_name};
pub use humanml::Humanml3dConfig;
pub use inspect::{ChannelSummary, Inspection, Problem, inspect, statistics};
pub use item::Item;
pub use item_set::ItemSet;
pub use labels::is_label;
pub use layout::{
    AUDIO_FILE, MANIFEST, MOTION_FILE, PREPARATION, check_id, features_path, motion_path,
};
pub use loader::{BatchShare, Loader, Samples};
pub use magnitude::LARGEST;
pub use manifest::Songs;
pub use npy::{
    Array, MotionFile, Results, motion_bytes, parse as parse_array, parse_motion, read_array,
    read_motion, write_motion, write_values,
};
pub use npz::{features_bytes, parse_arrays, parse_features, write_features, write_song_features};
pub use pattern::matches;
pub use phrase_item::{PhraseItem, load_audio};
pub use phrase_samples::{PhraseSamples, target_statistics};
pub use phrase_set::PhraseSet;
pub use progress::{OpenProgress, no_progress};
pub use songs::{held_out_songs, song_of};
pub use split::Side;
pub use store::{Object, Store, StoreError};
pub use style_conditions::{LABEL, STYLE, STYLE_NUMBERS, StyleConditions, mean_style};
