//! The networks of CC-MotionGen: [`UNet1d`], the denoiser conditioned on audio (docs/sources.md,
//! section 1.5), and [`MotionDecoder`], which decodes its latents to motion.

pub mod attention;
pub mod channel_encoding;
pub mod decoder;
pub mod rotation;
pub mod unet1d;

use burn::module::Module;

pub use decoder::{DecoderConfig, MotionDecoder};
pub use unet1d::{
    AudioCondition, AudioConditioning, BEAT_CHANNELS, Beats, STYLE_VALUES, StyleCondition,
    StyleConditioning, UNet1d, UNet1dConfig, beat_labels,
};

/// The denoiser, which samples latents, and the latents' decoder: parameters `unet.*` and
/// `decoder.*` (CC-MotionGen, section 7.1; docs/sources.md, section 1.8).
#[derive(Module, Debug)]
pub struct MotionModel {
    /// Generates latents.
    pub unet: UNet1d,
    /// Decodes latents.
    pub decoder: MotionDecoder,
}
