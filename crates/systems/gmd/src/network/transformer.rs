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
use burn::tensor::activation::silu;
use kinegrad_kernels::Lengths;
use kinegrad_models::config::{MAX_LAYERS, MAX_WIDTH, must_be_even, must_divide};
use kinegrad_models::layers::{EncoderLayer, EncoderLayerConfig, Linear, NormOrder};
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_models::{Dropout, DropoutKey, Initializer, NamedSizes, NetworkConfig};
use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use kinegrad_train::clips::path_condition::{PATH_CHANNELS, PathTokens, kept_by};
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
    /// Conditions each frame on a root path (docs/sources.md, section 7, option C), for recipe
    /// `gmd_motion`. Not in the published network.
    pub path: bool,
    /// Place of the path's tokens, for networks with a path.
    pub path_tokens: PathTokens,
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
            path: false,
            path_tokens: PathTokens::Added,
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
            .hint("0.1 in the published training; 0 for none")?;
        let (key, tokens) = ("model.path_tokens", self.path_tokens);
        let allowed = "\"added\" or \"rows\" for `kind = \"mdm_transformer\"`";
        let found = "\"concatenated\"";
        require(tokens != PathTokens::Concatenated, key, found, allowed)
            .hint("its condition is one token, which has no place for a path of many frames")?;
        let allowed = "\"added\" without `model.path`";
        require(
            self.path || tokens == PathTokens::Added,
            key,
            "\"rows\"",
            allowed,
        )
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        let layer = 12 * self.latent_dim + 3 * self.ff_size;
        let rows = if self.path && self.path_tokens == PathTokens::Rows {
            frames
        } else {
            0
        };
        ((frames + rows) as u64 + 1) * self.num_layers as u64 * layer as u64
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
        let path = init.at("embed_path");
        let embed_path = || {
            let (width, last) = (self.latent_dim, path.at("2"));
            let outer = Linear::new(width, width, &last);
            let outer = match self.path_tokens {
                PathTokens::Rows => outer,
                _ => outer.zeroed(&last),
            };
            (Linear::new(PATH_CHANNELS, width, &path.at("0")), outer)
        };
        let (embed_path_at_0, embed_path_at_2) = self.path.then(embed_path).unzip();
        Ok(Encoder {
            embed_path_at_0,
            embed_path_at_2,
            path_tokens: self.path_tokens,
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
    embed_path_at_0: Option<Linear>,
    embed_path_at_2: Option<Linear>,
    seqTransEncoder_at_layers: Vec<EncoderLayer>,
    output_process_at_poseFinal: Linear,
    dropout: Dropout,
    #[module(skip)]
    path_tokens: PathTokens,
}

/// The paths of a batch.
#[derive(Clone, Copy, Debug)]
pub struct PathInput<'a> {
    /// `[batch, PATH_CHANNELS, time]`.
    pub path: &'a Tensor<3>,
    /// 1 for motions conditioned on their path, else 0: `[batch, 1, 1]`. `None` conditions all
    /// motions.
    pub mask: Option<&'a Tensor<3>>,
}

impl Encoder {
    /// # Shapes
    /// - x, output: `[batch, in_channels, time]`
    /// - cond: `[batch, latent_dim]`, which becomes the first token
    ///
    /// A `path` adds to the frames, or is a row per frame behind the frames. Motions without a path
    /// attend to no row.
    pub fn forward(
        &self,
        x: Tensor<3>,
        cond: Tensor<2>,
        path: Option<PathInput<'_>>,
        dropout: DropoutKey,
    ) -> Tensor<3> {
        let [batch, _, time] = x.dims();
        let frames = self.input_process_at_poseEmbedding.forward_frames(x);
        let path = path.and_then(|path| Some((self.embedded_path(path.path)?, path.mask)));
        let (mut tokens, mut seen) = (vec![cond.unsqueeze_dim(2)], None);
        let mut places: Vec<f64> = (0..=time).map(|place| place as f64).collect();
        match path {
            None => tokens.push(frames),
            Some((path, mask)) if self.path_tokens == PathTokens::Rows => {
                let kept = kept_by(mask, batch).into_iter();
                let lengths = kept.map(|kept| 1 + time + if kept { time } else { 0 });
                seen = Some(Lengths::new(lengths));
                places.extend_from_within(1..);
                tokens.extend([frames, path]);
            }
            Some((path, Some(mask))) => tokens.push(frames + path * mask.clone()),
            Some((path, None)) => tokens.push(frames + path),
        }
        let tokens = Tensor::cat(tokens, 2);
        let width = tokens.dims()[1];
        let positions = interleaved_sinusoidal(&places, width, &tokens.device());
        let h = tokens + positions.transpose().unsqueeze::<3>();
        let mut h = self.dropout.forward(h, dropout);
        for layer in &self.seqTransEncoder_at_layers {
            h = layer.forward_seeing(h, seen.as_ref(), dropout);
        }
        let output = self.output_process_at_poseFinal.forward_frames(h);
        output.narrow(2, 1, time)
    }

    /// True if the network has a path condition.
    pub fn has_path(&self) -> bool {
        self.embed_path_at_0.is_some()
    }

    fn embedded_path(&self, path: &Tensor<3>) -> Option<Tensor<3>> {
        let inner = self.embed_path_at_0.as_ref()?.forward_frames(path.clone());
        Some(self.embed_path_at_2.as_ref()?.forward_frames(silu(inner)))
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_models::parameters;

    use super::*;

    #[test]
    fn a_path_reaches_the_frames_and_a_masked_one_does_not() {
        let device = Device::flex();
        let values = |count: usize, step: f32| -> Vec<f32> {
            (0..count).map(|i| (i as f32 * step).sin()).collect()
        };
        let x = Tensor::<3>::from_data(TensorData::new(values(30, 0.7), [2, 3, 5]), &device);
        let path = TensorData::new(values(70, 0.3), [2, PATH_CHANNELS, 5]);
        let path = Tensor::<3>::from_data(path, &device);
        let mask = Tensor::from_data(TensorData::new(vec![1.0f32, 0.0], [2, 1, 1]), &device);
        let cond = Tensor::<2>::ones([2, 8], &device);
        for tokens in [PathTokens::Added, PathTokens::Rows] {
            let config = EncoderConfig {
                latent_dim: 8,
                num_layers: 2,
                num_heads: 2,
                ff_size: 12,
                dropout: 0.0,
                path: true,
                path_tokens: tokens,
            };
            let network = config
                .init(3, &Initializer::new(3, &device))
                .expect("a network");
            let mut weights = parameters::export(&network);
            for weight in &mut weights {
                if weight.info.name == "embed_path.2.weight" {
                    weight.values = values(64, 0.9);
                }
            }
            let network = parameters::load(network, weights).expect("its own weights");
            let run = |mask| {
                let path = PathInput { path: &path, mask };
                network.forward(x.clone(), cond.clone(), Some(path), None)
            };
            let without = network.forward(x.clone(), cond.clone(), None, None);
            let apart = |a: &Tensor<3>, b: &Tensor<3>| {
                let each = (a.clone() - b.clone()).abs().max_dim(1);
                each.try_into_vec_as::<f32>().expect("float32")
            };
            let whole = run(None);
            assert_eq!(whole.dims(), [2, 3, 5]);
            let moved = apart(&whole, &without);
            assert!(
                moved.iter().all(|moved| *moved > 1e-4),
                "{tokens:?}: {moved:?}"
            );
            let masked = run(Some(&mask));
            assert!(
                apart(&masked, &whole)[..5]
                    .iter()
                    .all(|apart| *apart < 1e-6)
            );
            let second = apart(&masked, &without)[5..].to_vec();
            assert!(
                second.iter().all(|apart| *apart < 1e-6),
                "{tokens:?}: {second:?}"
            );
        }
    }

    #[test]
    fn the_condition_reaches_every_frame() {
        let init = Initializer::new(3, &Device::flex());
        let config = EncoderConfig {
            latent_dim: 8,
            num_layers: 2,
            num_heads: 2,
            ff_size: 12,
            dropout: 0.1,
            ..EncoderConfig::mdm()
        };
        let network = config.init(3, &init).expect("a network");
        let values: Vec<f32> = (0..15).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::from_data(TensorData::new(values, [1, 3, 5]), &Device::flex());
        let answer = |cond: f32| {
            let cond = Tensor::full([1, 8], cond, &Device::flex())
                * interleaved_sinusoidal(&[3.0], 8, &Device::flex());
            network.forward(x.clone(), cond, None, None)
        };
        let difference = (answer(0.0) - answer(2.0)).abs();
        let least: f32 = difference.max_dim(1).min().into_scalar();
        assert!(least > 1e-4, "{least}");
    }
}
