//! The networks of CC-MotionGen: [`UNet1d`], the denoiser conditioned on audio (docs/sources.md, section
//! 1.5), and [`MotionDecoder`], which decodes its latents to motion.

pub mod attention;
pub mod channel_encoding;
pub mod decoder;
mod motion_model;
pub mod rotation;
pub mod unet1d;

pub use decoder::{DecoderConfig, MotionDecoder};
pub use motion_model::MotionModel;
pub use unet1d::{
    AudioCondition, AudioConditioning, BEAT_CHANNELS, Beats, STYLE_VALUES, StyleCondition,
    StyleConditioning, UNet1d, UNet1dConfig, beat_labels,
};
