use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_kernels::gelu;
use kinegrad_models::layers::{BiGru, Linear};
use kinegrad_models::{Initializer, Stages};
use kinegrad_motion::humanml::TEXT_CHANNELS;

use super::FlowConfig;
use super::features::{positions, velocities, whole_body};

/// Width of the text's projection for each joint.
const TEXT: usize = 32;

/// Features of a single joint in a frame: position 3, velocity 3.
const OWN: usize = 3 + 3;

/// Features shared by all joints of a frame: whole body 8, duration 1, text.
const SHARED: usize = 8 + 1 + TEXT;

const INPUTS: usize = OWN + SHARED;

/// The inputs of the encoder.
#[derive(Clone, Debug)]
pub struct History {
    /// Past frames in HumanML3D's features: `[batch, 12 J - 1, time]`.
    pub frames: Tensor<3>,
    /// Frames of each history, from 1 to `time`; later frames are ignored.
    pub lengths: Vec<usize>,
    /// The text's pooled feature: `[batch, 512]`; zeros mean no text.
    pub text: Tensor<2>,
    /// The length of the whole clip as a number: `[batch, 1]`; `None` means 0.
    pub duration: Option<Tensor<2>>,
}

/// Encodes past frames and a text as a context per joint (docs/sources.md, section 5). Should be
/// created with [`FlowConfig::init`](super::FlowConfig::init).
///
/// ```text
/// joint and frame:  position, velocity, body, duration, text_proj(text)
///   -> joint_mlp    linear, GELU, linear
///   -> gru          over frames, all joints side by side, in both directions or forwards
///   -> decoder      from the last state of each direction: linear, GELU, linear
/// ```
///
/// The encoder ignores rotations.
#[derive(Module, Debug)]
pub struct HistoryEncoder {
    text_proj: Linear,
    joint_mlp_at_0: Linear,
    joint_mlp_at_2: Linear,
    gru: BiGru,
    decoder_at_0: Linear,
    decoder_at_2: Linear,
    joints: usize,
    gru_dim: usize,
}

impl HistoryEncoder {
    pub(super) fn new(config: &FlowConfig, joints: usize, init: &Initializer) -> Self {
        let FlowConfig {
            joint_dim,
            context_dim,
            gru_dim,
            decoder_dim,
            ..
        } = *config;
        let (mlp, decoder) = (init.at("joint_mlp"), init.at("decoder"));
        let all = joints * context_dim;
        let gru = BiGru::new(all, gru_dim, &init.at("gru"));
        let summary = gru_dim * if config.bidirectional { 2 } else { 1 };
        Self {
            text_proj: Linear::new(TEXT_CHANNELS, TEXT, &init.at("text_proj")),
            joint_mlp_at_0: Linear::new(INPUTS, joint_dim, &mlp.at("0")),
            joint_mlp_at_2: Linear::new(joint_dim, context_dim, &mlp.at("2")),
            gru: match config.bidirectional {
                true => gru,
                false => gru.forwards(),
            },
            decoder_at_0: Linear::new(summary, decoder_dim, &decoder.at("0")),
            decoder_at_2: Linear::new(decoder_dim, all, &decoder.at("2")),
            joints,
            gru_dim,
        }
    }

    /// # Shapes
    /// - output: `[batch, context_dim, J]`
    pub fn forward(&self, history: History) -> Tensor<3> {
        self.forward_stages(history, &mut ())
    }

    /// [`forward`](Self::forward) with stages: `joint_inputs` `[batch, time, J, 47]`,
    /// `joint_latents` `[batch, time, J, context_dim]`, `gru_sequence` `[batch, time, 2 gru_dim]`,
    /// `summary` `[batch, 2 gru_dim]`.
    pub fn forward_stages(&self, history: History, stages: &mut impl Stages) -> Tensor<3> {
        let History {
            frames,
            lengths,
            text,
            duration,
        } = history;
        let [batch, channels, time] = frames.dims();
        let joints = self.joints;
        // In the order of steps, for the recurrent layer.
        let count = time * batch;
        let rows = frames.permute([2, 0, 1]).reshape([count, channels]);

        // 1. The inputs per joint and frame.
        let body = whole_body(&rows, joints);
        let text = self.text_proj.forward(text);
        let duration = duration.unwrap_or_else(|| Tensor::zeros([batch, 1], &rows.device()));
        let clip = Tensor::cat(vec![duration, text], 1)
            .unsqueeze_dim::<3>(0)
            .expand([time, batch, 1 + TEXT])
            .reshape([count, 1 + TEXT]);
        let shared = Tensor::cat(vec![body, clip], 1);
        let own = Tensor::cat(vec![positions(&rows, joints), velocities(&rows, joints)], 2);
        stages.stage(format_args!("joint_inputs"), || {
            let shared = shared.clone().unsqueeze_dim::<3>(1);
            let shared = shared.expand([count, joints, SHARED]);
            let inputs = Tensor::cat(vec![own.clone(), shared], 2);
            inputs
                .reshape([time, batch, joints, INPUTS])
                .swap_dims(0, 1)
        });

        // 2. Over time. Inputs shared by all joints are multiplied once per frame.
        let own = own.swap_dims(1, 2);
        let latents = self.joint_mlp_at_0.forward_frames_sharing(own, shared);
        let latents = self.joint_mlp_at_2.forward_frames(gelu(latents));
        let context_dim = latents.dims()[1];
        let latents = latents.swap_dims(1, 2);
        stages.stage(format_args!("joint_latents"), || {
            let by_frame = [time, batch, joints, context_dim];
            latents.clone().reshape(by_frame).swap_dims(0, 1)
        });
        let sequence = latents.reshape([time, batch, joints * context_dim]);
        let sequence = sequence.permute([1, 2, 0]);
        let initial = Tensor::zeros([2, 1, self.gru_dim], &sequence.device());
        let states = self.gru.forward(sequence, &lengths, initial);
        stages.stage(format_args!("gru_sequence"), || {
            let mut all = vec![states.forward.clone()];
            all.extend(states.backward.clone());
            Tensor::cat(all, 2).swap_dims(0, 1)
        });
        stages.stage(format_args!("summary"), || states.last.clone());

        // 3. The contexts of the joints.
        let contexts = gelu(self.decoder_at_0.forward(states.last));
        let contexts = self.decoder_at_2.forward(contexts);
        contexts
            .reshape([batch, joints, context_dim])
            .swap_dims(1, 2)
    }
}
