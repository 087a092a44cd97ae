//! The motion and the trajectory model of Guided Motion Diffusion (appendix A, C and E).
//!
//! The motion model: clips of joint features with an absolute root, normalised, then projected so
//! that the root's three channels weigh as much as all others:
//!
//! ```text
//! x = ((u - mean) / std) P          P from `emphasis`, stored with the weights
//! L = clip_loss(x)                  sample prediction unless `diffusion.prediction_type` is set
//! ```
//!
//! `loss.joint_velocity` and `loss.foot_contact` add terms of the joints ([`JointMotion`]).
//!
//! Without a projection, `loss.trajectory_scale` k weighs the first four channels by k^2 instead
//! (appendix C.1; the height among them, as in the published program).
//!
//! The trajectory model: those four channels alone, the root's rotation, x, z and height,
//! normalised and not projected, predicting the noise. A model of four channels overfits quickly
//! and then responds poorly to guidance, so its recipe uses early stopping on held-out paths
//! (`train.patience`).

use crate::network::TextDenoiser;
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;

use super::JointMotion;
use super::loss::clip_loss;
use crate::GmdLossConfig;
use kinegrad_train::denoising::{DenoisingRecipe, HeldOut, Inputs};

/// Trains a [`TextDenoiser`] on clips of `channels`, complete motion or the root trajectory, over
/// `diffusion`, validated on `held_out`. Random inputs are noise of the network's space.
pub fn clip_recipe(
    diffusion: GaussianDiffusion,
    channels: usize,
    loss: &GmdLossConfig,
    joint_motion: Option<JointMotion>,
    held_out: HeldOut,
) -> DenoisingRecipe<TextDenoiser> {
    let mut channel_weights = vec![1.0; channels];
    channel_weights[..TRAJECTORY_CHANNELS].fill(loss.trajectory_scale.powi(2));
    let velocity = loss.velocity;
    DenoisingRecipe::new(
        diffusion,
        held_out,
        move |diffusion, model: &TextDenoiser, inputs, draws, weighted| {
            let x_start = match model.projection() {
                Some(projection) => projection.forward(inputs.x_start),
                None => inputs.x_start,
            };
            let inputs = Inputs { x_start, ..inputs };
            let (target, mask) = (inputs.x_start.clone(), inputs.mask.clone());
            let mut loss = clip_loss(
                diffusion,
                model,
                inputs,
                draws,
                &channel_weights,
                velocity,
                weighted,
            );
            if let Some(joint_motion) = &joint_motion {
                let output = loss.probes.iter().find(|(name, _)| *name == "model_output");
                let (_, prediction) = output.expect("the output of the network").clone();
                for (name, term) in joint_motion.terms(prediction, target, mask) {
                    loss.total = loss.total + term.clone();
                    loss.terms.push((name, term));
                }
            }
            loss
        },
    )
    .averaging_samples()
}
