//! The transformer encoder over frames (Tevet et al. 2022, "Human Motion Diffusion Model",
//! <https://arxiv.org/abs/2209.14916>, section 3): the baseline of Guided Motion Diffusion.
//!
//! Parameters have the names of the published model and the layout of PyTorch's
//! `nn.TransformerEncoder`; layers normalize after each residual sum and use GELU.
#![expect(
    non_snake_case,
    reason = "fields are named as the published model's parameters"
)]

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH, must_be_even, must_divide};
use kinegrad_models::layers::{EncoderLayer, EncoderLayerConfig, Linear, NormOrder};
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_models::{Dropout, DropoutKey, Initializer, NamedSizes, NetworkConfig};
use kinegrad_settings::{InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sizes of an [`Encoder`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Width of a token.
    pub latent_dim: usize,
    /// Layers.
    pub num_layers: usize,
    /// Attention heads.
    pub num_heads: usize,
    /// Width between each layer's two linear maps.
    pub ff_size: usize,
    /// Dropout in training, of the tokens and within each layer.
    pub dropout: f64,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self::mdm()
    }
}

impl NetworkConfig for EncoderConfig {
    const KIND: &'static str = "mdm_transformer";

    const SIZES: NamedSizes<Self> = &[("mdm", Self::mdm), ("mdm_tiny", Self::mdm_tiny)];
}

impl EncoderConfig {
    /// The published size.
    pub fn mdm() -> Self {
        Self {
            latent_dim: 512,
            num_layers: 8,
            num_heads: 4,
            ff_size: 1024,
            dropout: 0.1,
        }
    }

    /// For tests and first steps.
    pub fn mdm_tiny() -> Self {
        Self {
            latent_dim: 64,
            num_layers: 2,
            ff_size: 128,
            ..Self::mdm()
        }
    }

    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        must_be_even(self.latent_dim, "the published model has 512")?;
        must_divide(self.num_heads, self.latent_dim).hint("the published model has 4")?;
        in_range("model.num_layers", self.num_layers, 1..=MAX_LAYERS)
            .hint("the published model has 8")?;
        in_range("model.ff_size", self.ff_size, 1..=MAX_WIDTH)
            .hint("the published model has 1024")?;
        in_range("model.dropout", self.dropout, 0.0..1.0)
            .hint("0.1 in the published training; 0 for none")
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        let layer = 12 * self.latent_dim + 3 * self.ff_size;
        (frames as u64 + 1) * self.num_layers as u64 * layer as u64
    }

    /// The network for motion of `in_channels`.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn init(&self, in_channels: usize, init: &Initializer) -> Result<Encoder, InvalidSetting> {
        self.validate()?;
        let sizes = EncoderLayerConfig {
            width: self.latent_dim,
            num_heads: self.num_heads,
            ff_size: self.ff_size,
            norm: NormOrder::Post,
            dropout: self.dropout,
        };
        let layers = init.at("seqTransEncoder").at("layers");
        let layer = |index: usize| sizes.init(index + 1, &layers.at(&index.to_string()));
        let pose = init.at("input_process").at("poseEmbedding");
        let last = init.at("output_process").at("poseFinal");
        Ok(Encoder {
            input_process_at_poseEmbedding: Linear::new(in_channels, self.latent_dim, &pose),
            seqTransEncoder_at_layers: (0..self.num_layers).map(layer).collect(),
            output_process_at_poseFinal: Linear::new(self.latent_dim, in_channels, &last),
            // The layers' dropouts have the next indices.
            dropout: Dropout::new(self.dropout, 0),
        })
    }
}

/// A transformer encoder over `[condition, frame 0, frame 1, ..]`, made by [`EncoderConfig::init`].
#[derive(Module, Debug)]
pub struct Encoder {
    input_process_at_poseEmbedding: Linear,
    seqTransEncoder_at_layers: Vec<EncoderLayer>,
    output_process_at_poseFinal: Linear,
    dropout: Dropout,
}

impl Encoder {
    /// # Shapes
    /// - x, output: `[batch, in_channels, time]`
    /// - cond: `[batch, latent_dim]`, which becomes the first token
    pub fn forward(&self, x: Tensor<3>, cond: Tensor<2>, dropout: DropoutKey) -> Tensor<3> {
        let time = x.dims()[2];
        let frames = self.input_process_at_poseEmbedding.forward_frames(x);
        let tokens = Tensor::cat(vec![cond.unsqueeze_dim(2), frames], 2);
        let width = tokens.dims()[1];
        let places: Vec<f64> = (0..=time).map(|place| place as f64).collect();
        let positions = interleaved_sinusoidal(&places, width, &tokens.device());
        let h = tokens + positions.transpose().unsqueeze::<3>();
        let mut h = self.dropout.forward(h, dropout);
        for layer in &self.seqTransEncoder_at_layers {
            h = layer.forward(h, dropout);
        }
        let output = self.output_process_at_poseFinal.forward_frames(h);
        output.narrow(2, 1, time)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn the_condition_reaches_every_frame() {
        let init = Initializer::new(3, &Device::flex());
        let config = EncoderConfig {
            latent_dim: 8,
            num_layers: 2,
            num_heads: 2,
            ff_size: 12,
            dropout: 0.1,
        };
        let network = config.init(3, &init).expect("a network");
        let values: Vec<f32> = (0..15).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::from_data(TensorData::new(values, [1, 3, 5]), &Device::flex());
        let answer = |cond: f32| {
            let cond = Tensor::full([1, 8], cond, &Device::flex())
                * interleaved_sinusoidal(&[3.0], 8, &Device::flex());
            network.forward(x.clone(), cond, None)
        };
        let difference = (answer(0.0) - answer(2.0)).abs();
        let least: f32 = difference.max_dim(1).min().into_scalar();
        assert!(least > 1e-4, "{least}");
    }
}
