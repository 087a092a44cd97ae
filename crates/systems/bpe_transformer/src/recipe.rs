//! Denoising of clips with one text each (docs/sources.md, section 6.7):
//!
//! ```text
//! L = mean over the batch of  sum over real frames and channels (x_start - f(x_t, t, text))^2
//!                              / (channels * real frames)
//! ```
//!
//! Each sample has a random mode, absolute or relative; frames do not attend to padding. A
//! path-conditioned network is given each clip's trajectory. `loss.velocity` adds the squared error
//! of differences from the previous frame.

use kinegrad_data::TEXT;
use kinegrad_diffusion::{GaussianDiffusion, Time};
use kinegrad_models::DropoutKey;
use kinegrad_train::clips::path_condition::RootTrajectories;
use kinegrad_train::clips::{ChannelWeights, clip_loss};
use kinegrad_train::denoising::{Conditions, DenoisingRecipe, HeldOut};

use super::BpeTables;
use crate::network::{BlendedTransformer, Pass, Switch, TextSegments};

/// Trains a [`BlendedTransformer`] on clips of `channels` according to `own`. Validation on
/// `held_out` uses sampling's mode at each timestep.
pub(super) fn recipe(
    diffusion: GaussianDiffusion,
    channels: usize,
    own: &BpeTables,
    trajectories: RootTrajectories,
    held_out: HeldOut,
) -> DenoisingRecipe<BlendedTransformer> {
    let (velocity, ratio) = (own.loss.velocity, own.positions.bpe_training_ratio);
    let paths = own.paths.clone();
    let switch = Switch {
        bpe_denoising_step: own.evaluation.bpe_denoising_step,
        num_train_timesteps: own.diffusion.num_train_timesteps,
    };
    let channel_weights = ChannelWeights::mean(&vec![1.0; channels]);
    DenoisingRecipe::new(
        diffusion,
        held_out,
        move |diffusion, network: &BlendedTransformer, inputs, draws, weighted| {
            let [batch, _, time] = inputs.x_start.dims();
            let lengths = match &inputs.lengths {
                Some(lengths) => lengths.frames().to_vec(),
                None => vec![time; batch],
            };
            let path = || trajectories.conditions(&inputs.x_start, &lengths);
            let path = network.has_path().then(path);
            let path_mask = paths.mask(draws.dropout, batch, &inputs.x_start.device());
            let segments = TextSegments::single(lengths);
            let is_relative = match modes(draws.dropout, batch, ratio) {
                Some(is_relative) => is_relative,
                None => {
                    let timesteps = draws.timesteps.iter();
                    timesteps.map(|&t| switch.is_relative(t)).collect()
                }
            };
            let forward = |x_t, time: &[Time], cond: &Conditions, dropout| {
                let pass = Pass {
                    segments: &segments,
                    is_relative: &is_relative,
                    dropout,
                    path: path.as_ref(),
                    path_mask: path_mask.as_ref(),
                };
                network.forward(x_t, time, cond.get(TEXT).clone().squeeze_dim(2), pass)
            };
            let weights = &channel_weights;
            clip_loss(
                diffusion, inputs, draws, weights, velocity, weighted, forward,
            )
        },
    )
    .averaging_samples()
}

/// The mask of relative samples in a training step; `None` without a key.
fn modes(key: DropoutKey, batch: usize, ratio: f64) -> Option<Vec<bool>> {
    let uniforms = key?.named("mode").uniforms(batch);
    Some(uniforms.into_iter().map(|u| f64::from(u) < ratio).collect())
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;

    #[test]
    fn samples_are_in_either_mode_as_often_as_asked() {
        let share = |ratio| {
            let is_relative = (0..50).flat_map(|step| {
                let key = Key::new(1, Purpose::Dropout).at(step);
                modes(Some(key), 64, ratio).expect("a key")
            });
            let is_relative: Vec<bool> = is_relative.collect();
            is_relative.iter().filter(|each| **each).count() as f64 / is_relative.len() as f64
        };
        assert!((share(0.5) - 0.5).abs() < 0.03);
        assert!((share(0.2) - 0.2).abs() < 0.03);
        assert_eq!((share(0.0), share(1.0)), (0.0, 1.0));
        assert_eq!(modes(None, 3, 0.5), None);
    }
}
