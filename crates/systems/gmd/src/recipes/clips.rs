//! The motion and the trajectory model of Guided Motion Diffusion (appendix A, C and E).
//!
//! The motion model trains on clips of joint features with an absolute root, projected so that the
//! root's three channels weigh as much as all other channels:
//!
//! ```text
//! x = ((u - mean) / std) P          P from `emphasis`, stored with the weights
//! L = mean over the batch of  w(t) sum over real frames and channels  w_c |target - f(x_t, t, text)|
//!                                  / real frames                      with the w_c adding up to 1
//! ```
//!
//! with the distance of `diffusion.loss_type` and the weights w(t) of `diffusion.snr_gamma`. GMD's
//! published program uses squares and no w(t) (docs/sources.md, section 4.10). `loss.velocity` adds
//! the squared error of differences from the previous frame.
//!
//! `loss.joint_velocity` and `loss.foot_contact` add terms of the joints ([`JointMotion`]). Without
//! a projection, `loss.trajectory_scale` k weighs the trajectory's channels by k^2 instead (appendix
//! C.1, `loss.trajectory_form`).
//!
//! The trajectory model predicts only the noise of the four root channels: rotation, x, z and
//! height. The trajectory model overfits quickly and then responds poorly to guidance, so its
//! recipe uses early stopping on held-out paths (`train.patience`).

use kinegrad_data::TEXT;
use kinegrad_diffusion::{GaussianDiffusion, Time};
use kinegrad_train::clips::clip_loss;
use kinegrad_train::clips::path_condition::RootTrajectories;
use kinegrad_train::denoising::{Conditions, DenoisingRecipe, HeldOut, Inputs};

use super::JointMotion;
use crate::GmdConfig;
use crate::network::TextDenoiser;
use crate::network::transformer::PathInput;

/// Trains a [`TextDenoiser`] on clips of `channels`, validated on `held_out`. The noise has the
/// network's space. `trajectories` are the paths of a path-conditioned network.
pub fn clip_recipe(
    diffusion: GaussianDiffusion,
    channels: usize,
    own: &GmdConfig,
    trajectories: Option<RootTrajectories>,
    joint_motion: Option<JointMotion>,
    held_out: HeldOut,
) -> DenoisingRecipe<TextDenoiser> {
    let (loss, paths) = (&own.loss, own.paths.clone());
    let channel_weights = loss
        .trajectory_form
        .weights(channels, loss.trajectory_scale);
    let velocity = loss.velocity;
    DenoisingRecipe::new(
        diffusion,
        held_out,
        move |diffusion, model: &TextDenoiser, inputs, draws, weighted| {
            let [batch, _, time] = inputs.x_start.dims();
            let device = inputs.x_start.device();
            let path = trajectories.as_ref().map(|trajectories| {
                let lengths = match &inputs.lengths {
                    Some(lengths) => lengths.frames().to_vec(),
                    None => vec![time; batch],
                };
                let path = trajectories.conditions(&inputs.x_start, &lengths);
                (path, paths.mask(draws.dropout, batch, &device))
            });
            let x_start = match model.projection() {
                Some(projection) => projection.forward(inputs.x_start),
                None => inputs.x_start,
            };
            let inputs = Inputs { x_start, ..inputs };
            let (target, mask) = (inputs.x_start.clone(), inputs.mask.clone());
            let network = |x_t, time: &[Time], cond: &Conditions, dropout| {
                let path = path.as_ref().map(|(path, mask)| PathInput {
                    path,
                    mask: mask.as_ref(),
                });
                let text = cond.get(TEXT).clone();
                model.forward_stages(x_t, time, text, path, dropout, &mut ())
            };
            let weights = &channel_weights;
            let mut loss = clip_loss(
                diffusion, inputs, draws, weights, velocity, weighted, network,
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
