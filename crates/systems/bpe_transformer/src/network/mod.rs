//! The transformer with blended positional encodings (Barquero et al. 2024, "Seamless Human Motion
//! Composition with Blended Positional Encodings", <https://arxiv.org/abs/2402.15509>;
//! docs/sources.md, section 6): one sequence for several texts. In absolute mode, frames attend
//! within their text's segment, with positions in the segment. In relative mode, frames attend
//! across segments, with only relative positions. Sampling begins in absolute mode and ends in
//! relative mode.
//!
//! Parameters have the names of the published model.
#![expect(
    non_snake_case,
    reason = "fields are named as the published model's parameters"
)]

mod config;
mod path_rows;
mod sublayers;
mod text_segments;

#[cfg(test)]
mod tests;

use burn::module::{Module, Param};
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Denoiser, Time};
use kinegrad_models::layers::{Embedding, LayerNorm, Linear};
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_models::{Dropout, DropoutKey, Initializer, Stages, parameters};
use kinegrad_random::Key;
use kinegrad_settings::InvalidSetting;
use kinegrad_train::clips::path_condition::kept_by;

pub use config::{BlendedConfig, HEAD_CHANNELS, ROTATED_CHANNELS};
pub use kinegrad_train::clips::path_condition::{PATH_CHANNELS, PathTokens};
pub use sublayers::{PoseCentricAttention, Shared};
pub use text_segments::{Segment, TextSegments};

use sublayers::SubLayer;

/// The sampling steps with relative positions: the published `bpe_denoising_step`, k. With T
/// timesteps, t is relative if `t <= T - k`, so `k - 1` steps are absolute. For k = -1 all steps
/// are absolute, for k = 0 none.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Switch {
    /// k.
    pub bpe_denoising_step: i64,
    /// T.
    pub num_train_timesteps: usize,
}

impl Switch {
    /// True if positions are relative at timestep `t`.
    pub fn is_relative(self, t: usize) -> bool {
        match self.bpe_denoising_step {
            ..0 => false,
            0 => true,
            k => t as i64 <= self.num_train_timesteps as i64 - k,
        }
    }
}

/// The inputs of a forward pass besides noise, time and texts.
#[derive(Clone, Copy, Debug)]
pub struct Pass<'a> {
    /// The texts of each motion over time.
    pub segments: &'a TextSegments,
    /// True for motions in relative mode.
    pub is_relative: &'a [bool],
    /// Key of dropout and stochastic depth, in training.
    pub dropout: DropoutKey,
    /// Root paths, `[batch, PATH_CHANNELS, time]`; `None` for motion without a path.
    pub path: Option<&'a Tensor<3>>,
    /// 1 for motions conditioned on their path, else 0: `[batch, 1, 1]`. `None` conditions all
    /// motions.
    pub path_mask: Option<&'a Tensor<3>>,
}

/// The network, made by [`BlendedConfig::init`].
#[derive(Module, Debug)]
pub struct BlendedTransformer {
    embed_captions: Option<Embedding>,
    embed_timestep_at_time_embed_at_0: Linear,
    embed_timestep_at_time_embed_at_2: Linear,
    embed_text: Linear,
    input_process_at_poseEmbedding: Linear,
    embed_path_at_0: Option<Linear>,
    embed_path_at_2: Option<Linear>,
    seqTransEncoder_at_pos_emb_at_absolute_at_scale: Param<Tensor<1>>,
    seqTransEncoder_at_project_in: Linear,
    seqTransEncoder_at_attn_layers_at_layers: Vec<SubLayer>,
    seqTransEncoder_at_attn_layers_at_final_norm: LayerNorm,
    seqTransEncoder_at_project_out: Linear,
    output_process_at_poseFinal: Linear,
    dropout: Dropout,
    depth: f64,
    horizon: usize,
    width: usize,
    #[module(skip)]
    path_tokens: PathTokens,
}

impl BlendedConfig {
    /// The network for motion of `in_channels` and texts of `text_channels`.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn init(
        &self,
        in_channels: usize,
        text_channels: usize,
        init: &Initializer,
    ) -> Result<BlendedTransformer, InvalidSetting> {
        self.validate()?;
        let width = self.latent_dim;
        let square = |init: &Initializer| Linear::new(width, width, init);
        let time = init.at("embed_timestep").at("time_embed");
        let encoder = init.at("seqTransEncoder");
        let attention = encoder.at("attn_layers");
        let pose = init.at("input_process").at("poseEmbedding");
        let path = init.at("embed_path");
        let last = init.at("output_process").at("poseFinal");
        let layers = attention.at("layers");
        let sub_layer = |index: usize| SubLayer::new(index, self, &layers.at(&index.to_string()));
        let embed_path = || {
            let last = path.at("2");
            let inner = Linear::new(PATH_CHANNELS, width, &path.at("0"));
            // Added tokens alone would change an untrained network: the queries' map of concatenated
            // ones is zero, and rows are keys of any value.
            let outer = match self.path_tokens {
                PathTokens::Added => square(&last).zeroed(&last),
                PathTokens::Concatenated | PathTokens::Rows => square(&last),
            };
            (inner, outer)
        };
        let (embed_path_at_0, embed_path_at_2) = self.path.then(embed_path).unzip();
        Ok(BlendedTransformer {
            embed_captions: None,
            embed_timestep_at_time_embed_at_0: square(&time.at("0")),
            embed_timestep_at_time_embed_at_2: square(&time.at("2")),
            embed_text: Linear::new(text_channels, width, &init.at("embed_text")),
            input_process_at_poseEmbedding: Linear::new(in_channels, width, &pose),
            embed_path_at_0,
            embed_path_at_2,
            seqTransEncoder_at_pos_emb_at_absolute_at_scale: encoder
                .constant([1], (width as f32).sqrt().recip()),
            seqTransEncoder_at_project_in: square(&encoder.at("project_in")),
            seqTransEncoder_at_attn_layers_at_layers: (0..2 * self.num_layers)
                .map(sub_layer)
                .collect(),
            seqTransEncoder_at_attn_layers_at_final_norm: LayerNorm::new(
                width,
                &attention.at("final_norm"),
            ),
            seqTransEncoder_at_project_out: square(&encoder.at("project_out")),
            output_process_at_poseFinal: Linear::new(width, in_channels, &last),
            dropout: Dropout::new(self.dropout, 0),
            depth: self.dropout,
            horizon: self.horizon,
            width,
            path_tokens: self.path_tokens,
        })
    }
}

impl BlendedTransformer {
    /// The same network with a learned embedding for each of `captions` captions.
    #[must_use]
    pub fn with_captions(self, captions: usize, init: &Initializer) -> Self {
        let features = self.embed_text.inputs();
        Self {
            embed_captions: Some(Embedding::of_captions(captions, features, init)),
            ..self
        }
    }

    /// # Shapes
    /// - x_t, output: `[batch, channels, time]`
    /// - texts: `[texts, text channels]`, or `[texts, captions]`; zeros mean no text
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn forward(
        &self,
        x_t: Tensor<3>,
        time: &[Time],
        texts: Tensor<2>,
        pass: Pass<'_>,
    ) -> Tensor<3> {
        self.forward_stages(x_t, time, texts, pass, &mut ())
    }

    /// [`forward`](Self::forward) with stages, `[batch, width, time]`: `cond`, `pose_embedding`,
    /// `project_in`, `absolute`, `tokens`, `layerI.branch` and `layerI.sum` of sub-layer I,
    /// `final_norm`, `project_out`.
    ///
    /// # Panics
    /// As [`forward`](Self::forward).
    pub fn forward_stages(
        &self,
        x_t: Tensor<3>,
        time: &[Time],
        texts: Tensor<2>,
        pass: Pass<'_>,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let ([batch, _, frames], device) = (x_t.dims(), x_t.device());
        let Pass {
            segments,
            is_relative,
            dropout,
            path,
            path_mask,
        } = pass;
        assert_eq!(
            (segments.len(), is_relative.len(), time.len()),
            (batch, batch, batch),
            "segments, a mode and a time for each motion"
        );
        let shared = Shared::new(
            self.conditions(time, texts, segments),
            segments.rows(frames, &device),
            segments.ranges(frames, self.horizon, is_relative),
            is_relative,
        );
        stages.stage(format_args!("cond"), || shared.cond(batch));
        let h = self.input_process_at_poseEmbedding.forward_frames(x_t);
        stages.stage(format_args!("pose_embedding"), || h.clone());
        let project_in = &self.seqTransEncoder_at_project_in;
        stages.stage(format_args!("project_in"), || {
            project_in.forward_frames(h.clone())
        });
        let absolute = self.absolute(segments, is_relative, frames, &device);
        stages.stage(format_args!("absolute"), || absolute.clone());
        let path = path.and_then(|path| self.embedded_path(path));
        let places = match self.path_tokens {
            PathTokens::Rows => path.is_some().then(|| absolute.clone()),
            PathTokens::Added | PathTokens::Concatenated => None,
        };
        let h = project_in.forward_frames_onto(absolute, h);
        let (h, shared) = match (path, self.path_tokens) {
            (None, _) => (h, shared),
            (Some(path), PathTokens::Added) => (h + masked(path, path_mask), shared),
            (Some(path), PathTokens::Concatenated) => {
                (h, shared.with_concatenated(masked(path, path_mask)))
            }
            (Some(path), PathTokens::Rows) => {
                let has_path = kept_by(path_mask, batch);
                let path = path + places.expect("rows have places");
                let tokens = Tensor::cat(vec![h, path], 2);
                (tokens, shared.with_rows(&has_path, is_relative))
            }
        };
        stages.stage(format_args!("tokens"), || h.clone());
        let mut h = self.dropout.forward(h, dropout);
        let layers = &self.seqTransEncoder_at_attn_layers_at_layers;
        let left_out = self.left_out(dropout, layers.len());
        for (index, (layer, left_out)) in layers.iter().zip(left_out).enumerate() {
            if left_out {
                continue;
            }
            stages.stage(format_args!("layer{index}.branch"), || {
                layer.branch(h.clone(), &shared)
            });
            h = layer.forward(h, &shared);
            stages.stage(format_args!("layer{index}.sum"), || h.clone());
        }
        let h = self
            .seqTransEncoder_at_attn_layers_at_final_norm
            .forward_tokens(h);
        let h = match self.path_tokens {
            PathTokens::Rows => h.narrow(2, 0, frames),
            PathTokens::Added | PathTokens::Concatenated => h,
        };
        stages.stage(format_args!("final_norm"), || h.clone());
        let h = self.seqTransEncoder_at_project_out.forward_frames(h);
        stages.stage(format_args!("project_out"), || h.clone());
        self.output_process_at_poseFinal.forward_frames(h)
    }

    /// The embedding of a path, `[batch, width, time]`, which is added to the tokens; zeros before
    /// training.
    fn embedded_path(&self, path: &Tensor<3>) -> Option<Tensor<3>> {
        let inner = self.embed_path_at_0.as_ref()?.forward_frames(path.clone());
        Some(self.embed_path_at_2.as_ref()?.forward_frames(silu(inner)))
    }

    /// True if the network has a path condition.
    pub fn has_path(&self) -> bool {
        self.embed_path_at_0.is_some()
    }

    /// The same network with only the path embedding and the last layers trainable.
    #[must_use]
    pub fn adapting(self, last_layers: usize) -> Self {
        // Copies of uninitialized parameters lose the flag `require_grad`.
        let values = parameters::values(&self);
        let this = parameters::replace(self, values);
        let (first, second) = (this.embed_path_at_0.clone(), this.embed_path_at_2.clone());
        let layers = this.seqTransEncoder_at_attn_layers_at_layers.clone();
        let mut adapting = this.no_grad();
        (adapting.embed_path_at_0, adapting.embed_path_at_2) = (first, second);
        let frozen = layers.len().saturating_sub(2 * last_layers);
        let with_layers = &mut adapting.seqTransEncoder_at_attn_layers_at_layers;
        let both = std::mem::take(with_layers)
            .into_iter()
            .zip(layers)
            .enumerate();
        let each = both.map(|(index, (still, layer))| match index < frozen {
            true => still.with_path_query_of(&layer),
            false => layer,
        });
        *with_layers = each.collect();
        adapting
    }

    /// True if [`adapting`](Self::adapting) trains the parameter of this name.
    pub fn adapts(&self, name: &str, last_layers: usize) -> bool {
        let layers = self.seqTransEncoder_at_attn_layers_at_layers.len();
        let layer = name.strip_prefix("seqTransEncoder.attn_layers.layers.");
        let layer = layer.and_then(|rest| rest.split('.').next()?.parse().ok());
        let is_last = |layer: usize| layer >= layers.saturating_sub(2 * last_layers);
        let is_path = name.starts_with("embed_path.") || name.ends_with(".path_query.weight");
        is_path || layer.is_some_and(is_last)
    }

    /// The embeddings of timesteps: `[batch, width]`.
    pub fn embed_time(&self, time: &[Time], device: &Device) -> Tensor<2> {
        let timesteps: Vec<f64> = time.iter().map(|time| time.0).collect();
        let rows = interleaved_sinusoidal(&timesteps, self.width, device);
        let inner = silu(self.embed_timestep_at_time_embed_at_0.forward(rows));
        self.embed_timestep_at_time_embed_at_2.forward(inner)
    }

    /// The condition of each row of [`TextSegments::conditions`]: `[conditions, width]`.
    fn conditions(&self, time: &[Time], texts: Tensor<2>, segments: &TextSegments) -> Tensor<2> {
        let device = texts.device();
        let time = self.embed_time(time, &device);
        let texts = match &self.embed_captions {
            Some(table) => table.mixed(texts),
            None => texts,
        };
        let count = texts.dims()[0];
        let texts = self.embed_text.forward(texts);
        let texts = Tensor::cat(vec![texts, Tensor::zeros([1, self.width], &device)], 0);
        let [motions, rows] = segments.conditions(count, &device);
        time.select(0, motions) + texts.select(0, rows)
    }

    /// Absolute positions for motions in absolute mode, zeros for other motions: `[batch, width,
    /// time]`.
    fn absolute(
        &self,
        segments: &TextSegments,
        is_relative: &[bool],
        frames: usize,
        device: &Device,
    ) -> Tensor<3> {
        let places = segments.places(frames);
        let number = 1 + places.iter().flatten().copied().max().unwrap_or_default();
        // Segments share positions.
        let each: Vec<f64> = (0..number).map(|place| place as f64).collect();
        let table = absolute_positions(&each, self.width);
        let mut values = Vec::with_capacity(segments.len() * self.width * frames);
        for (places, is_relative) in places.into_iter().zip(is_relative) {
            match is_relative {
                true => values.extend(vec![0.0; self.width * frames]),
                false => values.extend(places.into_iter().flat_map(|place| {
                    let channels = table.chunks(number);
                    channels.map(move |of_places| of_places[place])
                })),
            }
        }
        let data = TensorData::new(values, [segments.len(), frames, self.width]);
        let scale = self.seqTransEncoder_at_pos_emb_at_absolute_at_scale.val();
        let positions = Tensor::from_data(data, device) * scale.reshape([1, 1, 1]);
        positions.swap_dims(1, 2)
    }

    /// True for the sub-layers that a training step skips.
    fn left_out(&self, dropout: DropoutKey, count: usize) -> Vec<bool> {
        let uniforms = |key: Key| key.named("depth").uniforms(count);
        let Some(uniforms) = dropout.filter(|_| self.depth > 0.0).map(uniforms) else {
            return vec![false; count];
        };
        let uniforms = uniforms.into_iter();
        uniforms.map(|u| f64::from(u) < self.depth).collect()
    }
}

/// `path` with zeros for the motions that `mask` leaves out.
fn masked(path: Tensor<3>, mask: Option<&Tensor<3>>) -> Tensor<3> {
    match mask {
        Some(mask) => path * mask.clone(),
        None => path,
    }
}

/// The table of absolute positions, `[width, places]`: `sin(p w_j)` for all j, then `cos(p w_j)`,
/// with `w_j = 10000^(-2 j / width)`.
pub fn absolute_positions(places: &[f64], width: usize) -> Vec<f32> {
    let half = width / 2;
    let row = |index: usize| {
        let frequency = 10_000f64.powf(-((index % half) as f64) / half as f64);
        let of = if index < half { f64::sin } else { f64::cos };
        places.iter().map(move |place| of(place * frequency) as f32)
    };
    (0..2 * half).flat_map(row).collect()
}

/// A network for the texts of one batch.
#[derive(Debug)]
pub struct Composed<'a> {
    /// The network.
    pub network: &'a BlendedTransformer,
    /// The texts of each motion over time.
    pub segments: TextSegments,
    /// The timesteps with relative positions.
    pub switch: Switch,
    /// Root paths, `[batch, PATH_CHANNELS, time]`.
    pub path: Option<Tensor<3>>,
    /// Guidance scale of the path; 1 disables its guidance.
    pub path_guidance_scale: f64,
}

impl Denoiser for Composed<'_> {
    /// `[texts, text channels, 1]`, zeros for no text.
    type Cond = Tensor<3>;

    /// With a path and its guidance scale s: `without + s (along - without)`, the outputs without the
    /// path and along it.
    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        let scale = self.path_guidance_scale;
        let Some(path) = self.path.as_ref().filter(|_| scale != 0.0) else {
            return self.predict_along(None, x_t, time, cond);
        };
        let along = self.predict_along(Some(path), x_t.clone(), time, cond);
        if scale == 1.0 {
            return along;
        }
        let without = self.predict_along(None, x_t, time, cond);
        without.clone() + (along - without) * scale
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.zeros_like()
    }
}

impl Composed<'_> {
    fn predict_along(
        &self,
        path: Option<&Tensor<3>>,
        x_t: Tensor<3>,
        time: &[Time],
        cond: &Tensor<3>,
    ) -> Tensor<3> {
        let timesteps = time.iter().map(|time| time.timestep());
        let is_relative: Vec<bool> = timesteps.map(|t| self.switch.is_relative(t)).collect();
        let pass = Pass {
            segments: &self.segments,
            is_relative: &is_relative,
            dropout: None,
            path,
            path_mask: None,
        };
        self.network
            .forward(x_t, time, cond.clone().squeeze_dim(2), pass)
    }
}
