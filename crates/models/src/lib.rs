//! Networks, independent of diffusion schedules, datasets and file locations.
//!
//! [`UNet1d`] is the audio-conditioned denoiser of CC-MotionGen (docs/sources.md, section 1.5). Its
//! parts are in [`layers`], with PyTorch's names and weight layouts, so that the path of a
//! parameter in the module tree *is* its state-dict name; [`parameters`] reads and writes them by
//! that name. [`lora`] adds low-rank adapters. [`gmd`] contains the networks of Guided Motion
//! Diffusion, [`transformer`] the encoder of its baseline, and [`TextDenoiser`] is a
//! text-conditioned denoiser with either of them; [`text_encoder`] is CLIP's text network. [`flow`] contains
//! the networks that continue a motion frame by frame, [`blended`] the transformer that composes a
//! motion of several texts, and [`text_motion`] the encoders of the text-motion evaluator.

pub mod attention;
pub mod blended;
pub mod channel_encoding;
pub mod config;
pub mod decoder;
pub mod dropout;
mod error;
pub mod flow;
pub mod gmd;
pub mod gradients;
pub mod init;
pub mod layers;
pub mod lora;
pub mod low_rank;
pub mod motion_model;
pub mod parameters;
pub mod res_block;
pub mod rotary;
pub mod rotation;
pub mod stages;
pub mod text_denoiser;
pub mod text_encoder;
pub mod text_motion;
pub mod time_embedding;
pub mod transformer;
pub mod unet1d;

pub use config::{NamedSizes, NetworkConfig};
pub use decoder::{DecoderConfig, MotionDecoder};
pub use dropout::{Dropout, DropoutKey};
pub use error::Error;
pub use flow::{FlowConfig, FlowModel};
pub use gradients::{GradientSum, gradients};
pub use init::Initializer;
pub use lora::{LoraConfig, LoraTarget};
pub use low_rank::LowRank;
pub use motion_model::MotionModel;
pub use stages::Stages;
pub use text_denoiser::{Backbone, TextDenoiser};
pub use unet1d::{
    AudioCondition, AudioConditioning, BEAT_CHANNELS, Beats, STYLE_VALUES, StyleCondition,
    StyleConditioning, UNet1d, UNet1dConfig, beat_labels,
};
