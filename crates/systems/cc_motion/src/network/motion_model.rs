//! Denoiser and decoder as one module.

use burn::module::Module;

use crate::network::{MotionDecoder, UNet1d};

/// The denoiser, whose samples are latents, and the decoder that makes motion of them: parameters
/// `unet.*` and `decoder.*` (CC-MotionGen, section 7.1; docs/sources.md, section 1.8).
#[derive(Module, Debug)]
pub struct MotionModel {
    /// Generates latents.
    pub unet: UNet1d,
    /// Decodes them.
    pub decoder: MotionDecoder,
}
