//! Layers and tools shared by the networks. The networks are in the crates of their systems.
//!
//! [`layers`] have PyTorch's names and weight layouts. The path of a parameter in the module tree
//! *is* the state-dict name, which [`parameters`] uses. [`lora`] adds low-rank adapters;
//! [`text_encoder`] is CLIP's text encoder.

pub mod config;
pub mod dropout;
mod error;
pub mod gradients;
pub mod init;
pub mod layers;
pub mod lora;
pub mod low_rank;
pub mod parameters;
pub mod res_block;
pub mod rotary;
pub mod stages;
pub mod text_encoder;
pub mod time_embedding;

pub use config::{NamedSizes, NetworkConfig};
pub use dropout::{Dropout, DropoutKey};
pub use error::Error;
pub use gradients::{GradientSum, gradients};
pub use init::Initializer;
pub use lora::{LoraConfig, LoraTarget};
pub use low_rank::LowRank;
pub use stages::Stages;
