//! The transformer encoder over frames (Tevet et al. 2022, "Human Motion Diffusion Model",
//! <https://arxiv.org/abs/2209.14916>, section 3): the baseline of Guided Motion Diffusion.
//!
//! Parameters have the names of the published model and the layout of PyTorch's
//! `nn.TransformerEncoder`; layers normalise after each sum and activate by GELU.
#![expect(
    non_snake_case,
    reason = "fields are named as the published model's parameters"
)]

use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::{Convolution, gelu, self_attention};
use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{MAX_LAYERS, MAX_WIDTH};
use crate::gmd::interleaved_sinusoidal;
use crate::layers::{LayerNorm, Linear};
use crate::{Initializer, NamedSizes, NetworkConfig};

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
    /// Width inside each layer's two linear maps.
    pub ff_size: usize,
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
    /// Names the key that no network can be built from.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let width = self.latent_dim;
        require(
            (2..=MAX_WIDTH).contains(&width) && width.is_multiple_of(2),
            "model.latent_dim",
            width,
            format!("an even number, 2 to {MAX_WIDTH}"),
        )
        .hint("the published model has 512")?;
        require(
            self.num_heads > 0 && width.is_multiple_of(self.num_heads),
            "model.num_heads",
            self.num_heads,
            format!("a divisor of model.latent_dim ({width})"),
        )
        .hint("the published model has 4")?;
        in_range("model.num_layers", self.num_layers, 1..=MAX_LAYERS)
            .hint("the published model has 8")?;
        in_range("model.ff_size", self.ff_size, 1..=MAX_WIDTH).hint("the published model has 1024")
    }

    /// Numbers that the backward pass keeps of one item of `frames` frames, roughly.
    pub fn activations(&self, frames: usize) -> u64 {
        let [width, ff_size] = [self.latent_dim, self.ff_size].map(|size| size as u64);
        let a_token = self.num_layers as u64 * (12 * width + 3 * ff_size);
        (frames as u64 + 1) * a_token
    }

    /// Builds the network for motion of `in_channels`; its parameters are drawn when they are first
    /// used.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn init(&self, in_channels: usize, init: &Initializer) -> Result<Encoder, InvalidSetting> {
        self.validate()?;
        let layers = init.at("seqTransEncoder").at("layers");
        let pose = init.at("input_process").at("poseEmbedding");
        let last = init.at("output_process").at("poseFinal");
        Ok(Encoder {
            input_process_at_poseEmbedding: Linear::new(in_channels, self.latent_dim, &pose),
            seqTransEncoder_at_layers: (0..self.num_layers)
                .map(|index| EncoderLayer::new(self, &layers.at(&index.to_string())))
                .collect(),
            output_process_at_poseFinal: Linear::new(self.latent_dim, in_channels, &last),
        })
    }
}

/// A transformer encoder over `[condition, frame 0, frame 1, ..]`. Should be created with
/// [`EncoderConfig::init`].
#[derive(Module, Debug)]
pub struct Encoder {
    input_process_at_poseEmbedding: Linear,
    seqTransEncoder_at_layers: Vec<EncoderLayer>,
    output_process_at_poseFinal: Linear,
}

impl Encoder {
    /// # Shapes
    /// - x, output: `[batch, in_channels, time]`
    /// - cond: `[batch, latent_dim]`, which becomes the first token
    pub fn forward(&self, x: Tensor<3>, cond: Tensor<2>) -> Tensor<3> {
        let time = x.dims()[2];
        let frames = self.input_process_at_poseEmbedding.forward_frames(x);
        let tokens = Tensor::cat(vec![cond.unsqueeze_dim(2), frames], 2);
        let width = tokens.dims()[1];
        let places: Vec<f64> = (0..=time).map(|place| place as f64).collect();
        let positions = interleaved_sinusoidal(&places, width, &tokens.device());
        let mut h = tokens + positions.transpose().unsqueeze::<3>();
        for layer in &self.seqTransEncoder_at_layers {
            h = layer.forward(h);
        }
        let output = self.output_process_at_poseFinal.forward_frames(h);
        output.narrow(2, 1, time)
    }
}

/// Queries, keys and values of `nn.MultiheadAttention` in one weight.
#[derive(Module, Debug)]
struct SelfAttention {
    in_proj_weight: Param<Tensor<2>>,
    in_proj_bias: Param<Tensor<1>>,
    out_proj: Linear,
    num_heads: usize,
}

impl SelfAttention {
    /// # Shapes
    /// - x, output: `[batch, width, tokens]`
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let projected = Convolution::new(self.in_proj_weight.val().unsqueeze_dim(2), 1)
            .bias(self.in_proj_bias.val())
            .forward(x);
        let attended = self_attention(projected, self.num_heads, None);
        self.out_proj.forward_frames(attended)
    }
}

/// `h = norm1(x + attention(x))`, `y = norm2(h + linear2(gelu(linear1(h))))`.
#[derive(Module, Debug)]
struct EncoderLayer {
    self_attn: SelfAttention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
}

impl EncoderLayer {
    fn new(config: &EncoderConfig, init: &Initializer) -> Self {
        let width = config.latent_dim;
        let attention = init.at("self_attn");
        Self {
            self_attn: SelfAttention {
                // Xavier's bound for a weight of `width` inputs and `3 width` outputs, as
                // `nn.MultiheadAttention` has it; its biases begin at zero.
                in_proj_weight: attention.bounded(
                    "in_proj_weight",
                    [3 * width, width],
                    (6.0 / (4 * width) as f64).sqrt(),
                ),
                in_proj_bias: attention.constant([3 * width], 0.0),
                out_proj: Linear::new(width, width, &attention.at("out_proj")),
                num_heads: config.num_heads,
            },
            linear1: Linear::new(width, config.ff_size, &init.at("linear1")),
            linear2: Linear::new(config.ff_size, width, &init.at("linear2")),
            norm1: LayerNorm::new(width, &init.at("norm1")),
            norm2: LayerNorm::new(width, &init.at("norm2")),
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let h = self.self_attn.forward(x.clone()) + x;
        let h = normalized(&self.norm1, h);
        let inner = gelu(self.linear1.forward_frames(h.clone()));
        let y = self.linear2.forward_frames(inner) + h;
        normalized(&self.norm2, y)
    }
}

/// Each token normalised over its channels: `[batch, width, tokens]`.
fn normalized(norm: &LayerNorm, x: Tensor<3>) -> Tensor<3> {
    let [batch, width, tokens] = x.dims();
    let rows = x.swap_dims(1, 2).reshape([batch * tokens, width]);
    norm.forward(rows)
        .reshape([batch, tokens, width])
        .swap_dims(1, 2)
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
        };
        let network = config.init(3, &init).expect("a network");
        let values: Vec<f32> = (0..15).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::from_data(TensorData::new(values, [1, 3, 5]), &Device::flex());
        let answer = |cond: f32| {
            let cond = Tensor::full([1, 8], cond, &Device::flex())
                * interleaved_sinusoidal(&[3.0], 8, &Device::flex());
            network.forward(x.clone(), cond)
        };
        let difference = (answer(0.0) - answer(2.0)).abs();
        let least: f32 = difference.max_dim(1).min().into_scalar();
        assert!(least > 1e-4, "{least}");
    }
}
