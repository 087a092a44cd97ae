//! How well motions match their captions: the metrics over embeddings of both, and the words that
//! captions are encoded by.
//!
//! The embeddings are those of the field's published pair of encoders (C. Guo et al., "Generating
//! Diverse and Natural 3D Human Motions from Text", 2022). [`TextMotionReport`] has the metrics.

mod report;
mod words;

pub use report::{DIVERSITY_PAIRS, POOL, TextMotionReport, multimodal_distance, r_precision};
pub use words::{MAX_WORDS, PartOfSpeech, Token, WordVectors, WordVectorsError};
