//! Decoders of the golden files. Their latents are not normalised.

use burn::tensor::Device;
use kinegrad_cc_motion::network::DecoderConfig;
use kinegrad_cc_motion::network::MotionDecoder;
use kinegrad_cc_motion::network::decoder::{DecoderInit, Normalization};
use kinegrad_models::Initializer;

/// CC-MotionGen's decoder with random weights.
///
/// # Panics
/// Panics if no decoder has these sizes.
pub fn of_size(hidden_dim: usize, num_layers: usize, device: &Device) -> MotionDecoder {
    let config = DecoderConfig {
        hidden_dim,
        num_layers,
        init: DecoderInit::Random,
        ..DecoderConfig::default()
    };
    let unit = Normalization {
        mean: vec![0.0; 25],
        std: vec![1.0; 25],
    };
    config
        .init(unit, &Initializer::new(0, device))
        .expect("a valid decoder")
}
