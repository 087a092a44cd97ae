//! The text encoder of CLIP (Radford et al. 2021, "Learning Transferable Visual Models From Natural
//! Language Supervision", <https://arxiv.org/abs/2103.00020>, section 2.4), never trained here.
//!
//! Parameters have the names and layouts of `CLIPTextModelWithProjection` of the Python package
//! `transformers`.

use burn::module::{Module, Param};
use burn::tensor::activation::{sigmoid, softmax};
use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_kernels::gelu;
use kinegrad_settings::{InvalidSetting, in_range, require};
use serde::Deserialize;

use crate::Initializer;
use crate::config::{MAX_LAYERS, MAX_WIDTH};
use crate::layers::{Embedding, LAYER_NORM_EPS, LayerNorm, Linear};

/// The largest vocabulary size: a token has two bytes.
const MAX_TOKENS: usize = 1 << 16;

/// The activation between the two linear maps of a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `x sigmoid(1.702 x)`, as used by OpenAI's weights.
    #[default]
    QuickGelu,
    /// The exact GELU.
    Gelu,
}

impl Activation {
    fn apply<const D: usize>(self, x: Tensor<D>) -> Tensor<D> {
        match self {
            Self::QuickGelu => x.clone() * sigmoid(x * 1.702),
            Self::Gelu => gelu(x),
        }
    }
}

/// The sizes of a [`ClipTextModel`], as in `text_config` of the published `config.json`. Defaults
/// are the sizes of ViT-B/32. Other keys are ignored.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default)]
pub struct ClipTextConfig {
    /// Size of the vocabulary.
    pub vocab_size: usize,
    /// Width of a token.
    pub hidden_size: usize,
    /// Width between the two linear maps of a layer.
    pub intermediate_size: usize,
    /// Layers.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Maximum number of tokens of a text.
    pub max_position_embeddings: usize,
    /// Width of the embedding of a text.
    pub projection_dim: usize,
    /// The activation of the layers.
    pub hidden_act: Activation,
    /// Epsilon of the layer normalizations.
    pub layer_norm_eps: f64,
}

impl Default for ClipTextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 49_408,
            hidden_size: 512,
            intermediate_size: 2048,
            num_hidden_layers: 12,
            num_attention_heads: 8,
            max_position_embeddings: 77,
            projection_dim: 512,
            hidden_act: Activation::QuickGelu,
            layer_norm_eps: LAYER_NORM_EPS,
        }
    }
}

impl ClipTextConfig {
    /// # Errors
    /// Returns the first invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("vocab_size", self.vocab_size, 3..=MAX_TOKENS)?;
        for (key, width) in [
            ("hidden_size", self.hidden_size),
            ("intermediate_size", self.intermediate_size),
            ("projection_dim", self.projection_dim),
        ] {
            in_range(key, width, 1..=MAX_WIDTH)?;
        }
        in_range("num_hidden_layers", self.num_hidden_layers, 1..=MAX_LAYERS)?;
        let heads = self.num_attention_heads;
        require(
            heads > 0 && self.hidden_size.is_multiple_of(heads),
            "num_attention_heads",
            heads,
            format!("a divisor of hidden_size ({})", self.hidden_size),
        )?;
        let positions = self.max_position_embeddings;
        in_range("max_position_embeddings", positions, 3..=MAX_TOKENS)?;
        let eps = self.layer_norm_eps;
        require(eps == LAYER_NORM_EPS, "layer_norm_eps", eps, LAYER_NORM_EPS)
    }

    /// Builds the network; parameters are initialized at first use.
    ///
    /// # Errors
    /// The errors of [`validate`](Self::validate).
    pub fn init(&self, init: &Initializer) -> Result<ClipTextModel, InvalidSetting> {
        self.validate()?;
        let (model, width) = (init.at("text_model"), self.hidden_size);
        let (embeddings, layers) = (model.at("embeddings"), model.at("encoder").at("layers"));
        let rows = |name, things| Embedding::new(things, width, &embeddings.at(name));
        let projection = init.at("text_projection");
        Ok(ClipTextModel {
            text_model_at_embeddings_at_token_embedding: rows("token_embedding", self.vocab_size),
            text_model_at_embeddings_at_position_embedding: rows(
                "position_embedding",
                self.max_position_embeddings,
            ),
            text_model_at_encoder_at_layers: (0..self.num_hidden_layers)
                .map(|index| ClipLayer::new(self, &layers.at(&index.to_string())))
                .collect(),
            text_model_at_final_layer_norm: LayerNorm::new(width, &model.at("final_layer_norm")),
            text_projection_at_weight: projection.uniform(
                "weight",
                [self.projection_dim, width],
                width,
            ),
        })
    }
}

/// The text encoder, created by [`ClipTextConfig::init`].
///
/// ```text
/// h_i   = token_embedding(token i) + position_embedding(i)
/// layer   h = h + out_proj(attention(layer_norm1(h)))    h = h + fc2(act(fc1(layer_norm2(h))))
/// text  = text_projection(final_layer_norm(h) at the end of the text)
/// ```
///
/// A token attends to itself and to earlier tokens.
#[derive(Module, Debug)]
pub struct ClipTextModel {
    text_model_at_embeddings_at_token_embedding: Embedding,
    text_model_at_embeddings_at_position_embedding: Embedding,
    text_model_at_encoder_at_layers: Vec<ClipLayer>,
    text_model_at_final_layer_norm: LayerNorm,
    text_projection_at_weight: Param<Tensor<2>>,
}

impl ClipTextModel {
    /// The embeddings of texts of any lengths.
    ///
    /// # Shapes
    /// - texts: the tokens of each text, including its start and end tokens
    /// - output: `[batch, projection_dim]`
    ///
    /// # Panics
    /// Panics if `texts` is empty, or a text has no tokens, too many tokens, or unknown tokens.
    pub fn forward(&self, texts: &[&[u16]], device: &Device) -> Tensor<2> {
        let batch = texts.len();
        let length = texts.iter().map(|tokens| tokens.len()).max().unwrap_or(0);
        let padded = texts.iter().flat_map(|tokens| {
            let tokens = tokens.iter().map(|&token| i64::from(token));
            tokens.chain(std::iter::repeat(0)).take(length)
        });
        let padded: Vec<i64> = padded.collect();
        let indices = |values: Vec<i64>| -> Tensor<1, Int> {
            let count = values.len();
            Tensor::from_data(TensorData::new(values, [count]), device)
        };
        let tokens = self
            .text_model_at_embeddings_at_token_embedding
            .forward(indices(padded));
        let places = self
            .text_model_at_embeddings_at_position_embedding
            .forward(indices((0..length as i64).collect()));
        let width = tokens.dims()[1];
        let h = tokens.reshape([batch, length, width]) + places.unsqueeze::<3>();
        let mut h = h.reshape([batch * length, width]);
        let future = future(length, device);
        for layer in &self.text_model_at_encoder_at_layers {
            h = layer.forward(h, batch, future.clone());
        }
        let ends = texts.iter().enumerate().map(|(index, tokens)| {
            let last = tokens.len().checked_sub(1).expect("a text has a token");
            (index * length + last) as i64
        });
        let h = h.select(0, indices(ends.collect()));
        let h = self.text_model_at_final_layer_norm.forward(h);
        h.matmul(self.text_projection_at_weight.val().transpose())
    }
}

/// The causal mask, added to the attention scores: `[1, tokens, tokens]`.
fn future(tokens: usize, device: &Device) -> Tensor<3> {
    let scores = (0..tokens).flat_map(|query| {
        (0..tokens).map(move |key| match key > query {
            true => f32::NEG_INFINITY,
            false => 0.0,
        })
    });
    let scores: Vec<f32> = scores.collect();
    Tensor::from_data(TensorData::new(scores, [1, tokens, tokens]), device)
}

#[derive(Module, Debug)]
struct ClipLayer {
    self_attn: ClipAttention,
    layer_norm1: LayerNorm,
    mlp_at_fc1: Linear,
    mlp_at_fc2: Linear,
    layer_norm2: LayerNorm,
    #[module(skip)]
    activation: Activation,
}

impl ClipLayer {
    fn new(config: &ClipTextConfig, init: &Initializer) -> Self {
        let (width, inner) = (config.hidden_size, config.intermediate_size);
        let mlp = init.at("mlp");
        let attention = init.at("self_attn");
        let linear = |name| Linear::new(width, width, &attention.at(name));
        Self {
            self_attn: ClipAttention {
                k_proj: linear("k_proj"),
                v_proj: linear("v_proj"),
                q_proj: linear("q_proj"),
                out_proj: linear("out_proj"),
                num_heads: config.num_attention_heads,
            },
            layer_norm1: LayerNorm::new(width, &init.at("layer_norm1")),
            mlp_at_fc1: Linear::new(width, inner, &mlp.at("fc1")),
            mlp_at_fc2: Linear::new(inner, width, &mlp.at("fc2")),
            layer_norm2: LayerNorm::new(width, &init.at("layer_norm2")),
            activation: config.hidden_act,
        }
    }

    /// # Shapes
    /// - h, output: `[batch * tokens, width]`
    /// - future: `[1, tokens, tokens]`
    fn forward(&self, h: Tensor<2>, batch: usize, future: Tensor<3>) -> Tensor<2> {
        let x = self.layer_norm1.forward(h.clone());
        let h = self.self_attn.forward(x, batch, future) + h;
        let x = self.mlp_at_fc1.forward(self.layer_norm2.forward(h.clone()));
        self.mlp_at_fc2.forward(self.activation.apply(x)) + h
    }
}

/// Attention with separate weights for queries, keys and values.
#[derive(Module, Debug)]
struct ClipAttention {
    k_proj: Linear,
    v_proj: Linear,
    q_proj: Linear,
    out_proj: Linear,
    num_heads: usize,
}

impl ClipAttention {
    fn forward(&self, x: Tensor<2>, batch: usize, future: Tensor<3>) -> Tensor<2> {
        let [rows, width] = x.dims();
        let (tokens, heads) = (rows / batch, self.num_heads);
        let head = width / heads;
        let by_head = |x: Tensor<2>| -> Tensor<3> {
            x.reshape([batch, tokens, heads, head])
                .swap_dims(1, 2)
                .reshape([batch * heads, tokens, head])
        };
        let q = by_head(self.q_proj.forward(x.clone()) / (head as f64).sqrt());
        let k = by_head(self.k_proj.forward(x.clone()));
        let v = by_head(self.v_proj.forward(x));
        let scores = q.matmul(k.swap_dims(1, 2)) + future;
        let attended = softmax(scores, 2).matmul(v);
        let attended = attended
            .reshape([batch, heads, tokens, head])
            .swap_dims(1, 2)
            .reshape([rows, width]);
        self.out_proj.forward(attended)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> ClipTextConfig {
        ClipTextConfig {
            vocab_size: 11,
            hidden_size: 12,
            intermediate_size: 20,
            num_hidden_layers: 2,
            num_attention_heads: 3,
            max_position_embeddings: 7,
            projection_dim: 5,
            ..ClipTextConfig::default()
        }
    }

    fn embeddings(texts: &[&[u16]]) -> Vec<Vec<f32>> {
        let device = Device::flex();
        let network = small().init(&Initializer::new(4, &device)).expect("sizes");
        let output = network.forward(texts, &device);
        assert_eq!(output.dims(), [texts.len(), 5]);
        let values = output.try_into_vec_as::<f32>().expect("float32");
        values.chunks(5).map(<[f32]>::to_vec).collect()
    }

    fn near(one: &[f32], other: &[f32]) -> bool {
        one.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-6)
    }

    #[test]
    fn an_embedding_does_not_depend_on_the_batch() {
        let texts: [&[u16]; 3] = [&[9, 3, 10], &[9, 1, 2, 3, 4, 5, 10], &[9, 10]];
        let together = embeddings(&texts);
        for (text, found) in texts.iter().zip(&together) {
            let alone = &embeddings(&[text])[0];
            assert!(near(alone, found), "{alone:?} {found:?}");
            assert!(alone.iter().all(|value| value.is_finite()));
        }
        assert!(!near(&together[0], &together[2]));
    }

    #[test]
    fn the_order_of_tokens_matters() {
        let found = embeddings(&[&[9, 3, 4, 10], &[9, 4, 3, 10]]);
        assert!(!near(&found[0], &found[1]));
    }

    #[test]
    fn invalid_sizes_are_refused_by_their_keys() {
        type Change = fn(&mut ClipTextConfig);
        let cases: [(&str, Change); 5] = [
            ("vocab_size", |c| c.vocab_size = 70_000),
            ("hidden_size", |c| c.hidden_size = 0),
            ("num_attention_heads", |c| c.num_attention_heads = 5),
            ("max_position_embeddings", |c| c.max_position_embeddings = 2),
            ("layer_norm_eps", |c| c.layer_norm_eps = 1e-6),
        ];
        for (key, change) in cases {
            let mut config = small();
            change(&mut config);
            assert_eq!(config.validate().expect_err(key).key, key);
        }
    }
}
