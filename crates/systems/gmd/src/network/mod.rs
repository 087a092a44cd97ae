//! The networks of Guided Motion Diffusion: a UNet over time with adaptive group normalization
//! (appendix D, table D.1, figures D.1 and D.2), conditioned on the timestep and a text.
//!
//! Names, sizes and initialization follow the published models where these differ from the
//! appendix: residual shortcuts and the last convolution have kernel 1, convolutions between levels
//! have kernels 3 and 4.

mod conditioner;
mod input_skip;
mod projection;
mod res_block;
mod text_denoiser;
pub mod transformer;
mod unet;

pub use conditioner::Conditioner;
pub use projection::Projection;
pub use text_denoiser::{Along, Backbone, TextDenoiser};
pub use unet::{GmdUnet, GmdUnetConfig};

use input_skip::InputSkip;
