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
    /// Adds a fresh adapter without effect to every layer that `config` names, and freezes all
    /// other parameters. Existing adapters are merged first. Initial values depend only on the seed
    /// of `init` and on names; the device of `init` must be the network's.
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

    /// The network with its adapters merged into the weights; all weights are trainable.
    #[must_use]
    pub fn merge_adapters(self) -> Self {
        self.adapting(&Adapting::Merge).set_require_grad(true)
    }

    fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let (enc, mid, dec) = (adapting.at("enc"), adapting.at("mid"), adapting.at("dec"));
        let conv = |at: &Adapting<'_>, name: &str, layer: Conv1d| {
            at.layer(LoraTarget::Convolution, name, layer)
        };
        let attention = |at: &Adapting<'_>, block: Option<AttentionBlock>| {
            block.map(|block| block.adapting(&at.at("attn")))
        };
        let join = |at: &Adapting<'_>, layer: Option<Conv1d>| {
            layer.map(|layer| at.layer(LoraTarget::Conditioning, "audio", layer))
        };
        Self {
            audio_proj: self
                .audio_proj
                .map(|layer| adapting.layer(LoraTarget::Conditioning, "audio_proj", layer)),
            audio: self
                .audio
                .map(|audio| audio.adapting(&adapting.at("audio"))),
            style: self
                .style
                .map(|style| style.adapting(&adapting.at("style"))),
            input_conv: conv(adapting, "input_conv", self.input_conv),
            enc: numbered(self.enc, &enc, |level, at| EncoderLevel {
                res: numbered(level.res, &at.at("res"), ResBlock::adapting),
                attn: attention(at, level.attn),
                down: level.down.map(|layer| conv(at, "down", layer)),
                audio: join(at, level.audio),
            }),
            mid: Bottleneck {
                res1: self.mid.res1.adapting(&mid.at("res1")),
                attn: self.mid.attn.adapting(&mid.at("attn")),
                res2: self.mid.res2.adapting(&mid.at("res2")),
            },
            dec: numbered(self.dec, &dec, |level, at| DecoderLevel {
                res: numbered(level.res, &at.at("res"), ResBlock::adapting),
                attn: attention(at, level.attn),
                up: level.up.map(|layer| conv(at, "up", layer)),
                audio: join(at, level.audio),
            }),
            output_conv: conv(adapting, "output_conv", self.output_conv),
            ..self
        }
    }
}

/// Applies `each` to the items of a list, at names with the items' indices.
pub(super) fn numbered<T>(
    items: Vec<T>,
    adapting: &Adapting<'_>,
    each: impl Fn(T, &Adapting<'_>) -> T,
) -> Vec<T> {
    let items = items.into_iter().enumerate();
    items
        .map(|(index, item)| each(item, &adapting.at(&index.to_string())))
        .collect()
}

#[cfg(test)]
mod tests;
