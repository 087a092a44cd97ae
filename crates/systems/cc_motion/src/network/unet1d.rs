//! The audio-conditioned UNet over time (CC-MotionGen, section 3.1; docs/sources.md, section 1.5).

mod adapters;
mod audio;
mod beats;
#[cfg(test)]
mod beats_tests;
mod config;
mod constant_tempo;
mod style;
#[cfg(test)]
mod style_tests;
#[cfg(test)]
mod tests;

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_diffusion::{Denoiser, Time};
use kinegrad_kernels::concat_channels;
use kinegrad_models::layers::{Conv1d, Linear};
use kinegrad_models::res_block::{ResBlock, ResBlockConfig};
use kinegrad_models::time_embedding::TimeEmbedding;
use kinegrad_models::{DropoutKey, Initializer, Stages};
use kinegrad_settings::{InvalidSetting, Refused, require};

use crate::network::attention::AttentionBlock;
use audio::{AudioContext, AudioEncoder, widths};
use style::StyleEmbedding;

pub use audio::{AudioCondition, AudioConditioning};
pub use beats::{BEAT_CHANNELS, Beats, beat_labels};
pub use config::UNet1dConfig;
pub use style::{STYLE_VALUES, StyleCondition, StyleConditioning};

impl UNet1dConfig {
    /// Builds the network for motion of `in_channels` with `cond_channels` conditions per frame,
    /// with lazy parameters. If beats are tracked, the last [`BEAT_CHANNELS`] conditions are the
    /// beat labels.
    ///
    /// # Errors
    /// As [`validate`](Self::validate); also if beats are tracked without labels.
    pub fn init(
        &self,
        in_channels: usize,
        cond_channels: usize,
        init: &Initializer,
    ) -> Result<UNet1d, InvalidSetting> {
        self.validate()?;
        require(
            self.beats == Beats::Given || cond_channels > BEAT_CHANNELS,
            "model.beats",
            format!("\"tracked\" in {cond_channels} audio features"),
            "audio features with beats, to learn from",
        )
        .hint("set `data.audio_features = [\"ccmotion\", \"beats\"]`")?;
        let builder = Builder {
            config: self,
            init,
            dropout_layers: 0,
        };
        Ok(builder.build(in_channels, cond_channels))
    }
}

/// One level of the encoder: residual blocks, attention, skip connection, then downsampling by 2.
#[derive(Module, Debug)]
struct EncoderLevel {
    res: Vec<ResBlock>,
    attn: Option<AttentionBlock>,
    down: Option<Conv1d>,
    /// Adds the audio context of this level to its input.
    audio: Option<Conv1d>,
}

/// The coarsest level's middle.
#[derive(Module, Debug)]
struct Bottleneck {
    res1: ResBlock,
    attn: AttentionBlock,
    res2: ResBlock,
}

/// One level of the decoder: skip connection, residual blocks, attention, then upsampling by 2.
#[derive(Module, Debug)]
struct DecoderLevel {
    res: Vec<ResBlock>,
    attn: Option<AttentionBlock>,
    up: Option<Conv1d>,
    /// Adds the audio context of this level to the output of the coarser level.
    audio: Option<Conv1d>,
}

/// The denoiser. Should be created with [`UNet1dConfig::init`].
///
/// Decoder level `i` of the module tree is level `i` of CC-MotionGen's figure, so the forward pass
/// runs decoder levels in reverse. As in the figure, an inner decoder level has one residual block
/// and attention. The coarsest and the finest level have two residual blocks and no attention.
#[derive(Module, Debug)]
pub struct UNet1d {
    time_embed: TimeEmbedding,
    style: Option<StyleEmbedding>,
    audio_proj: Option<Linear>,
    audio: Option<AudioEncoder>,
    input_conv: Conv1d,
    enc: Vec<EncoderLevel>,
    mid: Bottleneck,
    dec: Vec<DecoderLevel>,
    output_conv: Conv1d,
}

struct Builder<'a> {
    config: &'a UNet1dConfig,
    init: &'a Initializer,
    dropout_layers: usize,
}

impl Builder<'_> {
    fn res_block(&mut self, inputs: usize, outputs: usize, init: &Initializer) -> ResBlock {
        let config = ResBlockConfig {
            time_embed_dim: self.config.time_embed_dim,
            use_scale_shift_norm: self.config.use_scale_shift_norm,
            dropout: self.config.dropout,
        };
        self.dropout_layers += 1;
        ResBlock::new(inputs, outputs, &config, self.dropout_layers - 1, init)
    }

    fn res_blocks(
        &mut self,
        count: usize,
        inputs: usize,
        width: usize,
        init: &Initializer,
    ) -> Vec<ResBlock> {
        let block = |j: usize| {
            let inputs = if j == 0 { inputs } else { width };
            self.res_block(inputs, width, &init.at("res").at(&j.to_string()))
        };
        (0..count).map(block).collect()
    }

    fn aligned(&self) -> bool {
        self.config.audio_conditioning == AudioConditioning::Aligned
    }

    /// Channels of the audio context of a level.
    fn context_width(&self, level: usize) -> usize {
        match self.aligned() {
            true => widths(&self.config.channels(), self.config.context_dim)[level],
            false => self.config.context_dim,
        }
    }

    fn attention(&self, level: usize, channels: usize, init: &Initializer) -> AttentionBlock {
        let width = Some(self.context_width(level));
        let heads = self.config.heads(channels);
        AttentionBlock::new(channels, heads, width, init).with_positions(self.aligned())
    }

    fn join(&self, level: usize, channels: usize, init: &Initializer) -> Option<Conv1d> {
        let layer = || Conv1d::new(self.context_width(level), channels, 1, &init.at("audio"));
        self.aligned().then(layer)
    }

    fn encoder_level(&mut self, level: usize) -> EncoderLevel {
        let channels = self.config.channels();
        let init = self.init.at("enc").at(&level.to_string());
        let inputs = channels[level.saturating_sub(1)];
        let width = channels[level];
        EncoderLevel {
            res: self.res_blocks(self.config.num_res_blocks, inputs, width, &init),
            attn: (self.config.attention_levels().contains(&level))
                .then(|| self.attention(level, width, &init.at("attn"))),
            down: (level + 1 < channels.len())
                .then(|| Conv1d::strided(width, width, 3, 2, &init.at("down"))),
            audio: self.join(level, inputs, &init),
        }
    }

    fn decoder_level(&mut self, level: usize) -> DecoderLevel {
        let channels = self.config.channels();
        let init = self.init.at("dec").at(&level.to_string());
        let coarsest = channels.len() - 1;
        let attends = level != coarsest && self.config.attention_levels().contains(&level);
        // The output of a level has the width of the next finer level.
        let inputs = 2 * channels[level];
        let width = channels[level.saturating_sub(1)];
        let blocks = if attends { 1 } else { 2 };
        DecoderLevel {
            res: self.res_blocks(blocks, inputs, width, &init),
            attn: attends.then(|| self.attention(level, width, &init.at("attn"))),
            up: (level > 0).then(|| Conv1d::new(width, width, 3, &init.at("up"))),
            audio: (level != coarsest)
                .then(|| self.join(level, channels[level], &init))
                .flatten(),
        }
    }

    fn build(mut self, in_channels: usize, cond_channels: usize) -> UNet1d {
        let config = self.config;
        let channels = config.channels();
        let levels = channels.len();
        let coarsest = channels[levels - 1];
        let mid = self.init.at("mid");
        UNet1d {
            time_embed: TimeEmbedding::new(config.time_embed_dim, &self.init.at("time_embed")),
            style: {
                let (width, init) = (config.time_embed_dim, self.init.at("style"));
                StyleEmbedding::new(config.style, config.style_labels.len(), width, &init)
            },
            audio_proj: (!self.aligned()).then(|| {
                let init = self.init.at("audio_proj");
                Linear::new(cond_channels, config.context_dim, &init)
            }),
            audio: self.aligned().then(|| {
                let widths = widths(&channels, config.context_dim);
                let tracks = config.beats == Beats::Tracked;
                AudioEncoder::new(cond_channels, &widths, tracks, &self.init.at("audio"))
            }),
            input_conv: Conv1d::new(in_channels, channels[0], 3, &self.init.at("input_conv")),
            enc: (0..levels).map(|level| self.encoder_level(level)).collect(),
            mid: Bottleneck {
                res1: self.res_block(coarsest, coarsest, &mid.at("res1")),
                attn: self.attention(levels - 1, coarsest, &mid.at("attn")),
                res2: self.res_block(coarsest, coarsest, &mid.at("res2")),
            },
            dec: (0..levels).map(|level| self.decoder_level(level)).collect(),
            output_conv: Conv1d::new(channels[0], in_channels, 3, &self.init.at("output_conv")),
        }
    }
}

impl UNet1d {
    /// The network with timesteps multiplied by `scale`
    /// ([`timestep_scale`](kinegrad_diffusion::DiffusionConfig::timestep_scale)).
    #[must_use]
    pub fn with_timestep_scale(self, scale: f64) -> Self {
        let time_embed = self.time_embed.scaled(scale);
        Self { time_embed, ..self }
    }

    /// Predicts the network's target (noise, sample or velocity, as in training) for noisy motion.
    /// Any length of at least one frame is allowed.
    ///
    /// # Shapes
    /// - x_t, output: `[batch, in_channels, time]`
    /// - time: one per sample, in timesteps
    /// - cond: `[batch, cond_channels, time]`, with the clips' lengths if some clips are padded
    pub fn forward(
        &self,
        x_t: Tensor<3>,
        time: &[Time],
        cond: impl Into<AudioCondition>,
        dropout: DropoutKey,
    ) -> Tensor<3> {
        self.forward_stages(x_t, time, cond, dropout, &mut ())
    }

    /// [`forward`](Self::forward), with the output of each stage: `time_emb [batch,
    /// time_embed_dim]` including the style, `audio_ctx` (with aligned audio, `audio_ctx.i` for
    /// each level), `input_conv`, `enc.i` before downsampling (the skip connection), `mid`, and
    /// `dec.i` after upsampling, from the coarsest level to the finest.
    pub fn forward_stages(
        &self,
        x_t: Tensor<3>,
        time: &[Time],
        cond: impl Into<AudioCondition>,
        dropout: DropoutKey,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let cond = cond.into();
        let mut time_emb = self.time_embed.forward(time, &x_t.device());
        if let Some(style) = &self.style {
            time_emb = style.add_to(time_emb, cond.style.as_ref());
        }
        stages.stage(format_args!("time_emb"), || time_emb.clone());
        let audio = self.encode_audio(cond, stages);
        let attend = |block: &Option<AttentionBlock>, level: usize, h: Tensor<3>| match block {
            Some(block) => block.forward(h, Some(audio.context(level)), audio.lengths(level)),
            None => h,
        };

        let input_conv = self.input_conv.operation();
        let input_conv = input_conv.lengths(audio.lengths(0).cloned());
        let mut h = audio.join(&self.enc[0].audio, 0, input_conv).forward(x_t);
        stages.stage(format_args!("input_conv"), || h.clone());
        let mut skips = Vec::with_capacity(self.enc.len());
        for (index, level) in self.enc.iter().enumerate() {
            let lengths = audio.lengths(index);
            for block in &level.res {
                h = block.forward(h, time_emb.clone(), lengths, dropout);
            }
            h = attend(&level.attn, index, h);
            stages.stage(format_args!("enc.{index}"), || h.clone());
            skips.push(h.clone());
            if let Some(down) = &level.down {
                let down = down.operation().lengths(lengths.cloned());
                let coarser = &self.enc[index + 1];
                h = audio.join(&coarser.audio, index + 1, down).forward(h);
            }
        }

        let coarsest = self.enc.len() - 1;
        let lengths = audio.lengths(coarsest);
        let Bottleneck { res1, attn, res2 } = &self.mid;
        h = res1.forward(h, time_emb.clone(), lengths, dropout);
        h = attn.forward(h, Some(audio.context(coarsest)), lengths);
        h = res2.forward(h, time_emb.clone(), lengths, dropout);
        stages.stage(format_args!("mid"), || h.clone());

        for (index, level) in self.dec.iter().enumerate().rev() {
            let skip = skips.pop().expect("one skip a level");
            h = concat_channels(h, skip);
            for block in &level.res {
                h = block.forward(h, time_emb.clone(), audio.lengths(index), dropout);
            }
            h = attend(&level.attn, index, h);
            if let (Some(up), Some(skip)) = (&level.up, skips.last()) {
                let finer = index - 1;
                let up = up.operation().upsample(skip.dims()[2]);
                let up = up.lengths(audio.lengths(finer).cloned());
                h = audio.join(&self.dec[finer].audio, finer, up).forward(h);
            }
            stages.stage(format_args!("dec.{index}"), || h.clone());
        }
        let output_conv = self.output_conv.operation();
        output_conv.lengths(audio.lengths(0).cloned()).forward(h)
    }

    /// Sine and cosine of each frame's beat phase, `[batch, 2, time]`, as tracked in all features
    /// except the last [`BEAT_CHANNELS`]; `None` without a tracker.
    pub fn track_beats(&self, cond: &AudioCondition) -> Option<Tensor<3>> {
        let encoder = self.audio.as_ref()?;
        encoder.track(cond.features.clone(), cond.lengths.as_ref())
    }

    /// Sine and cosine of each frame's beat phase as input of the rest of the network: a constant
    /// tempo fitted to the tracked beats, with a norm of one; zeros in silence.
    pub fn find_beats(&self, cond: &AudioCondition) -> Option<Tensor<3>> {
        let encoder = self.audio.as_ref()?;
        encoder.find(cond.features.clone(), cond.lengths.as_ref())
    }

    fn encode_audio(&self, cond: AudioCondition, stages: &mut impl Stages) -> AudioContext {
        let levels = self.enc.len();
        match (&self.audio_proj, &self.audio) {
            (Some(projection), _) => {
                let context = projection.forward_frames(cond.features);
                stages.stage(format_args!("audio_ctx"), || context.clone());
                AudioContext(vec![(context, None); levels])
            }
            (None, encoder) => {
                let encoder = encoder.as_ref().expect("one of the two");
                let audio = encoder.forward(cond);
                for level in 0..levels {
                    stages.stage(format_args!("audio_ctx.{level}"), || audio.context(level));
                }
                audio
            }
        }
    }
}

impl Denoiser for UNet1d {
    type Cond = AudioCondition;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &AudioCondition) -> Tensor<3> {
        self.forward(x_t, time, cond.clone(), None)
    }

    fn null_cond(&self, cond: &AudioCondition) -> AudioCondition {
        cond.null()
    }

    fn null_style(&self, cond: &AudioCondition) -> Option<AudioCondition> {
        self.style.as_ref().and_then(|_| cond.null_style())
    }
}
