//! Reconstruction losses (CC-MotionGen, sections 7.1 and 7.5; docs/sources.md, section 1.8:
//! "decoder position" and "decoder quaternion").

use std::ops::Range;

use burn::tensor::{Tensor, s};
use kinegrad_motion::phrase::{PHASE, POSITION, QUATERNION};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::mean_frames;
use crate::network::rotation::hemisphere;

/// The treatment of q and -q.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SignMatching {
    /// Uses the nearer of q and -q.
    #[default]
    Nearer,
    /// As stored (CC-MotionGen): q and -q differ.
    Ccmotion,
}

/// The mean squared errors of position (m^2) and quaternion.
#[derive(Clone, Debug)]
pub struct ReconstructionLoss {
    /// Over channels 0 to 2.
    pub position: Tensor<1>,
    /// Over channels 9 to 12.
    pub quaternion: Tensor<1>,
}

impl ReconstructionLoss {
    /// Compares `decoded` with `target`. `weights`, one per sample, scale the errors in the mean
    /// but not the count. Weight 0 is for samples without signal of the ground truth.
    ///
    /// # Shapes
    /// - decoded, target: `[batch, 25, time]`, physical units
    /// - mask: `[batch, time]`
    /// - weights: `[batch, 1, 1]`
    pub fn new(
        decoded: &Tensor<3>,
        target: &Tensor<3>,
        mask: &Tensor<2>,
        weights: Tensor<3>,
        sign: SignMatching,
    ) -> Self {
        let target = match sign {
            SignMatching::Nearer => with_nearer_sign(target, decoded),
            SignMatching::Ccmotion => target.clone(),
        };
        let mask = mask.clone().unsqueeze_dim::<3>(1);
        let squared = (decoded.clone() - target).square() * weights;
        let mean =
            |channels: Range<usize>| mean_frames(squared.clone().slice(s![.., channels]), &mask);
        Self {
            position: mean(POSITION),
            quaternion: mean(QUATERNION),
        }
    }
}

/// The mean over all channels of the squared error in units of each channel's standard deviation,
/// with the quaternion up to sign. This is the loss of recipe `decoder`.
///
/// # Shapes
/// - decoded, target: `[batch, 25, time]`, physical units
/// - mask: `[batch, time]`
/// - weights: `[batch, 1, 1]`, as in [`ReconstructionLoss::new`]
/// - std: `[1, 25, 1]`
pub fn normalized_error(
    decoded: &Tensor<3>,
    target: &Tensor<3>,
    mask: &Tensor<2>,
    weights: Tensor<3>,
    std: &Tensor<3>,
) -> Tensor<1> {
    let target = with_nearer_sign(target, decoded);
    let error = (decoded.clone() - target) / std.clone();
    mean_frames(
        error.square() * weights,
        &mask.clone().unsqueeze_dim::<3>(1),
    )
}

/// `target` with each phase moved by whole bars as near as possible to the phase of `decoded`: 0.99
/// and 0.01 differ by 0.02.
pub fn with_nearer_phase(target: &Tensor<3>, decoded: &Tensor<3>) -> Tensor<3> {
    let phase = |x: &Tensor<3>| x.clone().without_autodiff().narrow(1, PHASE, 1);
    let reference = phase(target);
    let bars = (phase(decoded) - reference.clone()).round();
    with(target, PHASE..PHASE + 1, reference + bars)
}

/// `x` with other values in some `channels`.
fn with(x: &Tensor<3>, channels: Range<usize>, values: Tensor<3>) -> Tensor<3> {
    let before = x.clone().slice(s![.., ..channels.start]);
    let after = x.clone().slice(s![.., channels.end..]);
    Tensor::cat(vec![before, values, after], 1)
}

/// `target` with the sign of each quaternion that is nearer to the quaternion of `decoded`.
fn with_nearer_sign(target: &Tensor<3>, decoded: &Tensor<3>) -> Tensor<3> {
    let quaternion = |x: &Tensor<3>| x.clone().without_autodiff().slice(s![.., QUATERNION]);
    let reference = quaternion(target);
    let dot = (quaternion(decoded) * reference.clone()).sum_dim(1);
    with(target, QUATERNION, reference * hemisphere(dot))
}
