//! The conditioning vector of text-conditioned denoisers: timestep and text embeddings.

use burn::module::Module;
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::Time;
use kinegrad_models::Initializer;
use kinegrad_models::layers::Linear;
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_motion::humanml::TEXT_CHANNELS;

/// `time_embed(sinusoid(t)) + embed_text(text)`; `time_embed` is linear, SiLU, linear over a row of
/// the sinusoid table.
///
/// Without a text, the feature is zero *before* the linear map, so that the map's bias remains.
#[derive(Module, Debug)]
pub struct Conditioner {
    embed_timestep_at_time_embed_at_0: Linear,
    embed_timestep_at_time_embed_at_2: Linear,
    embed_text: Linear,
    width: usize,
}

impl Conditioner {
    /// A conditioner of `width` (even).
    pub fn new(width: usize, init: &Initializer) -> Self {
        let time = init.at("embed_timestep").at("time_embed");
        Self {
            embed_timestep_at_time_embed_at_0: Linear::new(width, width, &time.at("0")),
            embed_timestep_at_time_embed_at_2: Linear::new(width, width, &time.at("2")),
            embed_text: Linear::new(TEXT_CHANNELS, width, &init.at("embed_text")),
            width,
        }
    }

    /// # Shapes
    /// - text: `[batch, 512, 1]`
    /// - output: `[batch, width]`
    pub fn forward(&self, time: &[Time], text: Tensor<3>) -> Tensor<2> {
        self.time(time, &text.device()) + self.embed_text.forward(text.squeeze_dim(2))
    }

    /// The timestep's part: `[batch, width]`.
    pub fn time(&self, time: &[Time], device: &Device) -> Tensor<2> {
        let positions: Vec<f64> = time.iter().map(|time| time.0).collect();
        let rows = interleaved_sinusoidal(&positions, self.width, device);
        let inner = silu(self.embed_timestep_at_time_embed_at_0.forward(rows));
        self.embed_timestep_at_time_embed_at_2.forward(inner)
    }
}
