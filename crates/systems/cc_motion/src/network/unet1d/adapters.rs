//! Low-rank adapters on the UNet's layers.

use burn::module::Module;
use kinegrad_models::Initializer;
use kinegrad_models::layers::Conv1d;
use kinegrad_models::lora::{Adapting, LoraConfig, LoraTarget};
use kinegrad_models::res_block::ResBlock;
use kinegrad_settings::InvalidSetting;

use super::{Bottleneck, DecoderLevel, EncoderLevel, UNet1d};
use crate::network::attention::AttentionBlock;

impl UNet1d {
    /// Puts a fresh adapter on every layer that `config` names, which changes nothing yet, and
    /// freezes all other parameters. Adapters that the network has are merged first.
    ///
    /// The adapters' first values depend on the seed of `init` and on their names alone; its
    /// device is the network's.
    ///
    /// # Errors
    /// As [`LoraConfig::validate`].
    pub fn with_adapters(
        self,
        config: &LoraConfig,
        init: &Initializer,
    ) -> Result<Self, InvalidSetting> {
        config.validate()?;
        let frozen = self.merge_adapters().no_grad();
        Ok(frozen.adapting(&Adapting::Attach(config, init.clone())))
    }

    /// The plain network that computes the same: every adapter is added to its layer's weight and
    /// removed. All parameters can be trained again.
    #[must_use]
    pub fn merge_adapters(self) -> Self {
        self.adapting(&Adapting::Merge).set_require_grad(true)
    }

    fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let conv = |name, layer| adapting.layer(LoraTarget::Convolution, name, layer);
        let (enc, mid, dec) = (adapting.at("enc"), adapting.at("mid"), adapting.at("dec"));
        Self {
            audio_proj: self
                .audio_proj
                .map(|layer| adapting.layer(LoraTarget::Conditioning, "audio_proj", layer)),
            audio: self
                .audio
                .map(|encoder| encoder.adapting(&adapting.at("audio"))),
            style: self
                .style
                .map(|style| style.adapting(&adapting.at("style"))),
            input_conv: conv("input_conv", self.input_conv),
            enc: numbered(self.enc, &enc, |level, at| EncoderLevel {
                res: numbered(level.res, &at.at("res"), ResBlock::adapting),
                attn: optional_attention(level.attn, at),
                down: optional_convolution("down", level.down, at),
                audio: joining(level.audio, at),
            }),
            mid: Bottleneck {
                res1: self.mid.res1.adapting(&mid.at("res1")),
                attn: self.mid.attn.adapting(&mid.at("attn")),
                res2: self.mid.res2.adapting(&mid.at("res2")),
            },
            dec: numbered(self.dec, &dec, |level, at| DecoderLevel {
                res: numbered(level.res, &at.at("res"), ResBlock::adapting),
                attn: optional_attention(level.attn, at),
                up: optional_convolution("up", level.up, at),
                audio: joining(level.audio, at),
            }),
            output_conv: conv("output_conv", self.output_conv),
            ..self
        }
    }
}

/// Does it to every item of a list, whose place is its number.
fn numbered<T>(
    items: Vec<T>,
    adapting: &Adapting<'_>,
    each: impl Fn(T, &Adapting<'_>) -> T,
) -> Vec<T> {
    let items = items.into_iter().enumerate();
    items
        .map(|(index, item)| each(item, &adapting.at(&index.to_string())))
        .collect()
}

fn optional_attention(
    block: Option<AttentionBlock>,
    adapting: &Adapting<'_>,
) -> Option<AttentionBlock> {
    block.map(|block| block.adapting(&adapting.at("attn")))
}

fn optional_convolution(
    name: &str,
    layer: Option<Conv1d>,
    adapting: &Adapting<'_>,
) -> Option<Conv1d> {
    layer.map(|layer| adapting.layer(LoraTarget::Convolution, name, layer))
}

fn joining(layer: Option<Conv1d>, adapting: &Adapting<'_>) -> Option<Conv1d> {
    layer.map(|layer| adapting.layer(LoraTarget::Conditioning, "audio", layer))
}

#[cfg(test)]
mod tests;
