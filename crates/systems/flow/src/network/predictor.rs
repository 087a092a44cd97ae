use std::ops::ControlFlow;

use burn::module::Module;
use burn::tensor::{Int, Tensor, TensorData};
use kinegrad_diffusion::{Denoiser, FlowPrediction, Flowed, SamplerConfig, Time, sample_flow};
use kinegrad_kernels::{Convolution, cache_packed_weights, gelu};
use kinegrad_models::layers::{
    Embedding, EncoderLayer, EncoderLayerConfig, LayerNorm, Linear, NormOrder,
};
use kinegrad_models::{Initializer, Stages};
use kinegrad_motion::humanml::Skeleton;

use super::{FlowConfig, Hierarchy, PREVIOUS_STATE};

/// Width of the context's projection for each joint.
const CONTEXT: usize = 32;

const POSITION: usize = 3;

/// Inputs of each joint: context, previous state, noisy position, progress, flow time.
const INPUTS: usize = CONTEXT + PREVIOUS_STATE + POSITION + 1 + 1;

/// The condition of a pose.
#[derive(Clone, Debug)]
pub struct FlowCondition {
    /// From the history encoder: `[batch, context_dim, J]`.
    pub context: Tensor<3>,
    /// The context of the history without its text, for guidance.
    pub null_context: Option<Tensor<3>>,
    /// The last frame of the history ([`previous_state`](super::previous_state)): `[batch, 12, J]`.
    pub previous: Tensor<3>,
    /// Remaining frames divided by frames of the clip, from 1 at the start to 0 at the end:
    /// `[batch]`.
    pub progress: Tensor<1>,
}

/// The condition's part of the joints' tokens, computed once per pose ([`FlowPredictor::prepare`]).
#[derive(Clone, Debug)]
pub struct PreparedCondition {
    /// Tokens without noisy position and flow time: `[batch, latent_dim, J]`.
    tokens: Tensor<3>,
    null_tokens: Option<Tensor<3>>,
    /// Weights of noisy position and flow time: `[latent_dim, 4, 1]`.
    weight: Tensor<3>,
}

/// Predicts the velocity of a noisy pose at a flow time, 0 for noise and 1 for data
/// (docs/sources.md, section 5). A transformer encoder over joints, made by
/// [`FlowConfig::init`](super::FlowConfig::init).
///
/// ```text
/// joint:  ctx_proj(context), previous state, x_t, progress, t
///   -> in_proj, plus chain_emb and depth_emb of the joint
///   -> transformer over joints, no mask, no further positions
///   -> head: linear, GELU, linear
/// ```
#[derive(Module, Debug)]
pub struct FlowPredictor {
    ctx_proj: Linear,
    in_proj: Linear,
    chain_emb: Option<Embedding>,
    depth_emb: Option<Embedding>,
    transformer_at_layers: Vec<EncoderLayer>,
    transformer_at_norm: Option<LayerNorm>,
    head_at_0: Linear,
    head_at_2: Linear,
    #[module(skip)]
    hierarchy: Hierarchy,
    progress: bool,
}

impl FlowPredictor {
    pub(super) fn new(config: &FlowConfig, skeleton: &Skeleton, init: &Initializer) -> Self {
        let width = config.latent_dim;
        let hierarchy = Hierarchy::of(skeleton);
        let (transformer, head) = (init.at("transformer"), init.at("head"));
        let layers = transformer.at("layers");
        let sizes = EncoderLayerConfig {
            width,
            num_heads: config.num_heads,
            ff_size: config.ff_size,
            norm: config.norm,
            dropout: 0.0,
        };
        let final_norm = || LayerNorm::new(width, &transformer.at("norm"));
        let embedding = |count, name| {
            let embedding = || Embedding::new(count, width, &init.at(name));
            config.hierarchy.then(embedding)
        };
        let layer = |index: usize| sizes.init(index, &layers.at(&index.to_string()));
        Self {
            ctx_proj: Linear::new(config.context_dim, CONTEXT, &init.at("ctx_proj")),
            in_proj: Linear::new(INPUTS, width, &init.at("in_proj")),
            chain_emb: embedding(hierarchy.num_chains(), "chain_emb"),
            depth_emb: embedding(hierarchy.num_depths(), "depth_emb"),
            transformer_at_layers: (0..config.num_layers).map(layer).collect(),
            transformer_at_norm: (config.norm == NormOrder::Pre).then(final_norm),
            head_at_0: Linear::new(width, width, &head.at("0")),
            head_at_2: Linear::new(width, POSITION, &head.at("2")),
            hierarchy,
            progress: config.progress,
        }
    }

    /// # Shapes
    /// - x_t, output: `[batch, 3, J]`
    /// - t: flow time from 0 to 1, `[batch]`
    pub fn forward(&self, x_t: Tensor<3>, t: Tensor<1>, cond: &FlowCondition) -> Tensor<3> {
        self.forward_stages(x_t, t, cond, &mut ())
    }

    /// [`forward`](Self::forward) with stages: `inputs49` `[batch, 49, J]`, `tokens` and `encoded`
    /// `[batch, latent_dim, J]`.
    pub fn forward_stages(
        &self,
        x_t: Tensor<3>,
        t: Tensor<1>,
        cond: &FlowCondition,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let inputs = self.inputs(&cond.context, cond, x_t, t);
        stages.stage(format_args!("inputs49"), || inputs.clone());
        let h = self.tokens(inputs);
        self.velocity(h, stages)
    }

    /// The condition's part of the tokens, for [`Denoiser::predict`].
    pub fn prepare(&self, cond: &FlowCondition) -> PreparedCondition {
        let tokens = |context: &Tensor<3>| {
            let [batch, _, joints] = context.dims();
            let device = context.device();
            let pose = Tensor::zeros([batch, POSITION, joints], &device);
            self.tokens(self.inputs(context, cond, pose, Tensor::zeros([batch], &device)))
        };
        let columns = [INPUTS - 2 - POSITION..INPUTS - 2, INPUTS - 1..INPUTS];
        let columns = columns.map(|columns| self.in_proj.columns(columns));
        PreparedCondition {
            tokens: tokens(&cond.context),
            null_tokens: cond.null_context.as_ref().map(tokens),
            weight: Tensor::cat(columns.to_vec(), 1).unsqueeze_dim(2),
        }
    }

    /// Samples poses from noise `[batch, 3, J]`.
    ///
    /// # Errors
    /// The errors of [`sample_flow`].
    pub fn sample(
        &self,
        noise: Tensor<3>,
        cond: &FlowCondition,
        prediction: FlowPrediction,
        sampler: &SamplerConfig,
    ) -> Result<Flowed<3>, kinegrad_diffusion::Error> {
        let cond = self.prepare(cond);
        cache_packed_weights(|| {
            let on_step = &mut |_, _: &Tensor<3>| ControlFlow::Continue(());
            sample_flow(self, noise, &cond, prediction, sampler, on_step)
        })
    }

    /// `[batch, 49, J]`.
    fn inputs(
        &self,
        context: &Tensor<3>,
        cond: &FlowCondition,
        x_t: Tensor<3>,
        t: Tensor<1>,
    ) -> Tensor<3> {
        let [batch, _, joints] = x_t.dims();
        let progress = match self.progress {
            true => cond.progress.clone(),
            false => cond.progress.zeros_like(),
        };
        let parts = vec![
            self.ctx_proj.forward_frames(context.clone()),
            cond.previous.clone(),
            x_t,
            of_joints(progress, batch, joints),
            of_joints(t, batch, joints),
        ];
        Tensor::cat(parts, 1)
    }

    /// The transformer's output for tokens `[batch, latent_dim, J]`.
    fn velocity(&self, mut h: Tensor<3>, stages: &mut impl Stages) -> Tensor<3> {
        stages.stage(format_args!("tokens"), || h.clone());
        for layer in &self.transformer_at_layers {
            h = layer.forward(h, None);
        }
        if let Some(norm) = &self.transformer_at_norm {
            h = norm.forward_tokens(h);
        }
        stages.stage(format_args!("encoded"), || h.clone());
        self.head_at_2
            .forward_frames(gelu(self.head_at_0.forward_frames(h)))
    }

    /// Tokens `[batch, latent_dim, J]` of inputs `[batch, 49, J]`, with each joint's position in
    /// the skeleton.
    fn tokens(&self, inputs: Tensor<3>) -> Tensor<3> {
        let device = inputs.device();
        let tokens = self.in_proj.forward_frames(inputs);
        let (Some(chains), Some(depths)) = (&self.chain_emb, &self.depth_emb) else {
            return tokens;
        };
        let of = |places: &[usize], embedding: &Embedding| {
            let indices: Vec<i64> = places.iter().map(|&place| place as i64).collect();
            let indices = TensorData::new(indices, [places.len()]);
            embedding.forward(Tensor::<1, Int>::from_data(indices, &device))
        };
        let place = of(&self.hierarchy.chains, chains) + of(&self.hierarchy.depths, depths);
        tokens + place.transpose().unsqueeze::<3>()
    }
}

/// Repeats a number per sample for all joints: `[batch, 1, J]`.
fn of_joints(value: Tensor<1>, batch: usize, joints: usize) -> Tensor<3> {
    value.reshape([batch, 1, 1]).expand([batch, 1, joints])
}

impl Denoiser for FlowPredictor {
    type Cond = PreparedCondition;

    /// `time` contains flow times from 0 to 1.
    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &PreparedCondition) -> Tensor<3> {
        let [batch, _, joints] = x_t.dims();
        let times: Vec<f32> = time.iter().map(|time| time.0 as f32).collect();
        let t = Tensor::from_data(TensorData::new(times, [batch]), &x_t.device());
        let inputs = Tensor::cat(vec![x_t, of_joints(t, batch, joints)], 1);
        let tokens = Convolution::new(cond.weight.clone(), 1)
            .residual(cond.tokens.clone())
            .forward(inputs);
        self.velocity(tokens, &mut ())
    }

    /// The condition of the same history without its text.
    ///
    /// # Panics
    /// If the condition has no [`null_context`](FlowCondition::null_context).
    fn null_cond(&self, cond: &PreparedCondition) -> PreparedCondition {
        let tokens = cond.null_tokens.clone();
        PreparedCondition {
            tokens: tokens.expect("a context without text"),
            ..cond.clone()
        }
    }
}
