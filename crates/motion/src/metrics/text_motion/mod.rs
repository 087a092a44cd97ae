//! Metrics of motions and their captions.
//!
//! The embeddings come from the published pair of encoders (C. Guo et al., "Generating Diverse and
//! Natural 3D Human Motions from Text", 2022). [`TextMotionReport`] contains the metrics.

mod report;
mod words;

pub use report::{DIVERSITY_PAIRS, POOL, TextMotionReport, multimodal_distance, r_precision};
pub use words::{MAX_WORDS, PartOfSpeech, Token, WordVectors, WordVectorsError};
