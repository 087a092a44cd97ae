//! A text-conditioned denoiser of motion clips, with any backbone.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{Denoiser, Time};
use kinegrad_models::layers::Embedding;
use kinegrad_models::{DropoutKey, Initializer, Stages};
use kinegrad_motion::humanml::TEXT_CHANNELS;
use kinegrad_settings::InvalidSetting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::network::transformer::{Encoder, EncoderConfig, PathInput};
use crate::network::{Conditioner, GmdUnet, GmdUnetConfig, InputSkip, Projection};

/// The backbone and its sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Backbone {
    /// The UNet, over clips padded to one length.
    GmdUnet(GmdUnetConfig),
    /// The transformer encoder.
    MdmTransformer(EncoderConfig),
}

impl Default for Backbone {
    fn default() -> Self {
        Self::GmdUnet(GmdUnetConfig::default())
    }
}

impl Backbone {
    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        match self {
            Self::GmdUnet(config) => config.validate(),
            Self::MdmTransformer(config) => config.validate(),
        }
    }

    /// Approximate number of values kept for the backward pass, per item of `frames` frames.
    pub fn activations(&self, frames: usize) -> u64 {
        match self {
            Self::GmdUnet(config) => config.activations(),
            Self::MdmTransformer(config) => config.activations(frames),
        }
    }

    /// True for a network with a path condition.
    pub fn has_path(&self) -> bool {
        match self {
            Self::GmdUnet(_) => false,
            Self::MdmTransformer(config) => config.path,
        }
    }

    /// Maximum number of frames of a clip, if limited.
    pub fn longest(&self) -> Option<usize> {
        match self {
            Self::GmdUnet(config) => Some(config.padded_frames),
            Self::MdmTransformer(_) => None,
        }
    }
}

#[derive(Module, Debug)]
struct UnetDenoiser {
    unet: GmdUnet,
    input_skip: Option<InputSkip>,
    padded_frames: usize,
}

#[derive(Module, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a handful exist, and their weights are elsewhere"
)]
enum Network {
    Unet(UnetDenoiser),
    Transformer(Encoder),
}

/// A denoiser conditioned on timestep and text: parameters `embed_timestep.*`, `embed_text.*`, the
/// backbone's parameters, and optionally `embed_captions.weight` and `projection.matrix`.
///
/// The condition is the text's pooled feature `[batch, 512, 1]`, or one-hot
/// [captions](Self::with_captions), `[batch, captions, 1]`. Zeros mean no text.
#[derive(Module, Debug)]
pub struct TextDenoiser {
    embed_captions: Option<Embedding>,
    flat_conditioner: Conditioner,
    flat_network: Network,
    projection: Option<Projection>,
}

impl TextDenoiser {
    /// A network for motion of `in_channels`, without a projection.
    ///
    /// # Errors
    /// Names the invalid key.
    pub fn new(
        backbone: &Backbone,
        in_channels: usize,
        init: &Initializer,
    ) -> Result<Self, InvalidSetting> {
        let (network, width) = match backbone {
            Backbone::GmdUnet(config) => {
                let width = config.latent_dim;
                let skip = || InputSkip::new(in_channels, width, &init.at("input_skip"));
                let unet = UnetDenoiser {
                    unet: config.init(in_channels, width, &init.at("unet"))?,
                    input_skip: config.input_skip.then(skip),
                    padded_frames: config.padded_frames,
                };
                (Network::Unet(unet), width)
            }
            Backbone::MdmTransformer(config) => {
                let encoder = config.init(in_channels, init)?;
                (Network::Transformer(encoder), config.latent_dim)
            }
        };
        Ok(Self {
            embed_captions: None,
            flat_conditioner: Conditioner::new(width, init),
            flat_network: network,
            projection: None,
        })
    }

    /// The same network with a learned embedding per caption: `[captions, 512]`, initial variance
    /// 1.
    #[must_use]
    pub fn with_captions(self, captions: usize, init: &Initializer) -> Self {
        Self {
            embed_captions: Some(Embedding::of_captions(captions, TEXT_CHANNELS, init)),
            ..self
        }
    }

    /// The same network in the space of `matrix`, `[channels, channels]` row by row.
    #[must_use]
    pub fn in_space_of(self, matrix: Vec<f32>, device: &Device) -> Self {
        let (channels, init) = (matrix.len().isqrt(), Initializer::new(0, device));
        Self {
            projection: Some(Projection::new(matrix, channels, &init)),
            ..self
        }
    }

    /// The projection of the network's space, if any.
    pub fn projection(&self) -> Option<&Projection> {
        self.projection.as_ref()
    }

    /// The embedding of timestep and text.
    pub fn conditioner(&self) -> &Conditioner {
        &self.flat_conditioner
    }

    /// # Shapes
    /// - x_t, output: `[batch, channels, time]`, in the network's own space; a UNet takes at most
    ///   its padded length
    /// - text: `[batch, 512, 1]`, or `[batch, captions, 1]`
    ///
    /// # Panics
    /// Panics if a clip is longer than the UNet's padded length.
    pub fn forward(&self, x_t: Tensor<3>, time: &[Time], text: Tensor<3>) -> Tensor<3> {
        self.forward_stages(x_t, time, text, None, None, &mut ())
    }

    /// True if the network has a path condition.
    pub fn has_path(&self) -> bool {
        match &self.flat_network {
            Network::Unet(_) => false,
            Network::Transformer(encoder) => encoder.has_path(),
        }
    }

    /// [`forward`](Self::forward) with a transformer's path, its dropout in training, and a UNet's
    /// stages: `unet_in_padded` and `unet_out_padded` at the padded length, and the stages of
    /// [`GmdUnet::forward_stages`].
    ///
    /// # Panics
    /// As [`forward`](Self::forward).
    pub fn forward_stages(
        &self,
        x_t: Tensor<3>,
        time: &[Time],
        text: Tensor<3>,
        path: Option<PathInput<'_>>,
        dropout: DropoutKey,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let text = match &self.embed_captions {
            Some(table) => table.mixed(text.squeeze_dim(2)).unsqueeze_dim(2),
            None => text,
        };
        let cond = self.flat_conditioner.forward(time, text);
        match &self.flat_network {
            Network::Unet(network) => {
                let output = network.forward(x_t.clone(), cond, stages);
                match &network.input_skip {
                    Some(skip) => output + skip.forward(x_t, time),
                    None => output,
                }
            }
            Network::Transformer(encoder) => encoder.forward(x_t, cond, path, dropout),
        }
    }
}

impl UnetDenoiser {
    /// Pads with zeros of the noisy space on the right, without a mask, as in the published models.
    fn forward(&self, x: Tensor<3>, cond: Tensor<2>, stages: &mut impl Stages) -> Tensor<3> {
        let [batch, channels, time] = x.dims();
        assert!(
            time <= self.padded_frames,
            "a clip of {time} frames in a network for {}",
            self.padded_frames
        );
        let padding = self.padded_frames - time;
        let x = match padding {
            0 => x,
            _ => {
                let zeros = Tensor::zeros([batch, channels, padding], &x.device());
                Tensor::cat(vec![x, zeros], 2)
            }
        };
        stages.stage(format_args!("unet_in_padded"), || x.clone());
        let y = self.unet.forward_stages(x, cond, stages);
        stages.stage(format_args!("unet_out_padded"), || y.clone());
        match padding {
            0 => y,
            _ => y.narrow(2, 0, time),
        }
    }
}

impl Denoiser for TextDenoiser {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        self.forward(x_t, time, cond.clone())
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.zeros_like()
    }
}

/// A network with the paths of a batch.
#[derive(Debug)]
pub struct Along<'a> {
    /// The network.
    pub network: &'a TextDenoiser,
    /// Root paths, `[batch, PATH_CHANNELS, time]`.
    pub path: Option<Tensor<3>>,
    /// Guidance scale of the path; 1 disables its guidance.
    pub path_guidance_scale: f64,
}

impl Denoiser for Along<'_> {
    type Cond = Tensor<3>;

    /// With a path and its guidance scale s: `without + s (along - without)`, the outputs without the
    /// path and along it.
    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        let (network, scale) = (self.network, self.path_guidance_scale);
        let Some(path) = self.path.as_ref().filter(|_| scale != 0.0) else {
            return network.predict(x_t, time, cond);
        };
        let input = PathInput { path, mask: None };
        let along =
            network.forward_stages(x_t.clone(), time, cond.clone(), Some(input), None, &mut ());
        if scale == 1.0 {
            return along;
        }
        let without = network.predict(x_t, time, cond);
        without.clone() + (along - without) * scale
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        self.network.null_cond(cond)
    }
}
