//! Clips in the HumanML3D format: joint features with captions, and synthetic walks.
//!
//! A dataset is a folder, a bucket or a path on a web server with `new_joint_vecs/ID.npy`
//! (`[frames, 263]`, relative root), `texts/ID.txt` (captions) and a list of clips for each split.
//! See `docs/dataset.md`.
//!
//! ```
//! use std::sync::Arc;
//! use kinegrad_data::humanml::ClipSamples;
//! use kinegrad_data::{DataConfig, DataKind, Dataset, Loader};
//!
//! let mut config = DataConfig { kind: DataKind::SyntheticWalks, ..DataConfig::default() };
//! config.batch_size = 4;
//! config.synthetic.phrases = 6;
//! let dataset = Dataset::open(&config)?;
//! let statistics = Arc::new(dataset.statistics()?);
//! let (clips, representation) = (dataset.train, dataset.representation);
//! let samples = ClipSamples::new(clips, representation, statistics, 263, &config, 7);
//! let mut loader = Loader::new(samples, &config, 7, 0);
//! let batch = loader.next()?;
//! assert_eq!(batch.x_start.len(), 4 * 263 * 120);
//! assert_eq!(batch.conditions[0].values.len(), 4 * 512);
//! # Ok::<(), kinegrad_data::Error>(())
//! ```

mod caption_labels;
mod clip;
mod config;
mod embeddings;
mod find;
mod labels;
mod lists;
mod samples;
mod scan;
mod statistics;
mod synthetic;
mod texts;
mod word_vectors;

pub use caption_labels::{CaptionLabels, MAX_CAPTIONS};
pub use clip::{
    Clip, ClipSet, FEATURES, features_bytes, features_path, parse_features, write_features,
};
pub use config::{CaptionRule, CaptionText, Humanml3dConfig, SkeletonName};
pub use embeddings::{read_embedding, write_embeddings};
pub use find::find_clips;
pub use labels::{ClipLabels, LABELS, labels_bytes, labels_of, read_labels};
pub use samples::ClipSamples;
pub use statistics::statistics_files;
pub use synthetic::{synthetic_id, walk, write_walks};
pub use texts::{Caption, TEXTS, parse_captions, read_captions, texts_path};
pub use word_vectors::{parse_word_vectors, read_word_vectors};
