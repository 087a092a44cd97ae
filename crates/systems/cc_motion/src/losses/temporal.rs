//! Temporal coherence: explicit derivatives agree with finite differences, and motion has no jumps
//! (CC-MotionGen, section 7.2; docs/sources.md, section 1.7).
//!
//! With `d x[t] = x[t+1] - x[t]` and fps = 30, each term is a mean over frames (and components),
//! times its weight:
//!
//! ```text
//! jerk                 |fps d a|^2 / target_jerk^2
//! velocity_coherence   (v - fps d p)^2 / target_vel_coherence^2
//! accel_coherence      (a - fps d v)^2 / target_accel_coherence^2
//! quat_delta           max(0, target_quat_delta - |q[t] . q[t+1]|)
//! phase_monotonic      summed over time, mean over the batch: see PhaseLoss
//! quat_norm            (|q|^2 - 1)^2
//! angular_velocity     (w - fps log(q[t+1] q[t]*))^2 / target_angular_velocity^2
//! position_smoothness  max(0, |d p| - position_smoothness_threshold)
//! position_jerk        |fps^3 d d d p|^2 / target_jerk^2
//! ```
//!
//! CC-MotionGen names `position_smoothness` as a remedy (section 14.1). It lacks `quat_norm`,
//! `angular_velocity` and `position_jerk`. CC-MotionGen squares the root of the squared jerk,
//! with a NaN gradient for equal accelerations. This module sums the squares directly, with the
//! same value.

use burn::tensor::activation::relu;
use burn::tensor::{Bool, Tensor};
use kinegrad_motion::phrase::{
    ACCELERATION, ANGULAR_VELOCITY, FPS, PHASE, POSITION, QUATERNION, VELOCITY,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{mean_frames, sum_frames};
use crate::network::rotation::angular_velocity;

#[cfg(test)]
mod tests;

/// A larger drop of the phase is the wrap from the end of a bar to the beginning of the next bar.
const WRAP: f64 = 0.5;

/// The phase drops that count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PhaseLoss {
    /// Backward steps: `max(0, -d)` where `d >= -0.5`. Larger drops are wraps, which are valid.
    #[default]
    BackwardSteps,
    /// CC-MotionGen's `max(0, -d - 0.5)`, which penalizes wraps and ignores backward steps.
    Ccmotion,
}

/// The table `loss.temporal`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TemporalLossConfig {
    /// Weight of `velocity_coherence`.
    pub velocity_weight: f64,
    /// Weight of `accel_coherence`.
    pub acceleration_weight: f64,
    /// Weight of `jerk`.
    pub jerk_weight: f64,
    /// Weight of `quat_delta`.
    pub quat_delta_weight: f64,
    /// Weight of `phase_monotonic`.
    pub phase_monotonic_weight: f64,
    /// Weight of `quat_norm`; a decoder that normalizes its quaternions does not need this term.
    pub quat_norm_weight: f64,
    /// Weight of `angular_velocity`.
    pub angular_velocity_weight: f64,
    /// Weight of `position_smoothness`: steps of a coordinate beyond the threshold.
    pub position_smoothness_weight: f64,
    /// Step of a coordinate between two frames above which `position_smoothness` counts, meters.
    pub position_smoothness_threshold: f64,
    /// Weight of `position_jerk`, the squared jerk of the positions; the term also penalizes real
    /// motion.
    pub position_jerk_weight: f64,
    /// Meters per second cubed.
    pub target_jerk: f64,
    /// Meters per second.
    pub target_vel_coherence: f64,
    /// Meters per second squared.
    pub target_accel_coherence: f64,
    /// Dot product of consecutive quaternions above which the penalty is zero.
    pub target_quat_delta: f64,
    /// Radians per second.
    pub target_angular_velocity: f64,
    /// The phase drops that count.
    pub phase: PhaseLoss,
}

impl Default for TemporalLossConfig {
    fn default() -> Self {
        Self {
            velocity_weight: 10.0,
            acceleration_weight: 5.0,
            jerk_weight: 1.0,
            quat_delta_weight: 2.0,
            // The term is a sum over time, not a mean. At weight 1, the term outweighs all others
            // for phases with jitter, and the model learns a constant phase.
            phase_monotonic_weight: 0.001,
            quat_norm_weight: 0.0,
            angular_velocity_weight: 0.01,
            position_smoothness_weight: 0.0,
            position_smoothness_threshold: 0.5,
            position_jerk_weight: 0.0,
            target_jerk: 50_000.0,
            target_vel_coherence: 5.0,
            target_accel_coherence: 100.0,
            target_quat_delta: 0.95,
            target_angular_velocity: 10.0,
            phase: PhaseLoss::BackwardSteps,
        }
    }
}

impl TemporalLossConfig {
    /// CC-MotionGen's five terms, literally.
    pub fn ccmotion() -> Self {
        Self {
            phase_monotonic_weight: 1.0,
            angular_velocity_weight: 0.0,
            phase: PhaseLoss::Ccmotion,
            ..Self::default()
        }
    }
}

/// The weighted terms of `decoded` by name. Terms of weight 0 are omitted; motion of one frame has
/// no terms.
///
/// # Shapes
/// - decoded: `[batch, 25, time]`, physical units
/// - mask: `[batch, time]`
pub fn temporal_losses(
    decoded: &Tensor<3>,
    mask: &Tensor<2>,
    config: &TemporalLossConfig,
) -> Vec<(&'static str, Tensor<1>)> {
    let [batch, _, time] = decoded.dims();
    if time < 2 {
        return Vec::new();
    }
    let part = |range: std::ops::Range<usize>| decoded.clone().slice([0..batch, range]);
    let (p, v, a) = (part(POSITION), part(VELOCITY), part(ACCELERATION));
    let (q, w) = (part(QUATERNION), part(ANGULAR_VELOCITY));
    let phase = part(PHASE..PHASE + 1);
    let frames = mask.clone().unsqueeze_dim::<3>(1);
    let pairs = ends(frames.clone()).0 * ends(frames.clone()).1;

    let mut terms = Vec::new();
    let mut add = |name, weight: f64, term: &dyn Fn() -> Tensor<1>| {
        if weight != 0.0 {
            terms.push((name, term() * weight));
        }
    };
    add("jerk", config.jerk_weight, &|| {
        let square = (differences(a.clone()) / config.target_jerk).square();
        mean_frames(square.sum_dim(1), &pairs)
    });
    add("velocity_coherence", config.velocity_weight, &|| {
        let error = ends(v.clone()).0 - differences(p.clone());
        mean_frames((error / config.target_vel_coherence).square(), &pairs)
    });
    add("accel_coherence", config.acceleration_weight, &|| {
        let error = ends(a.clone()).0 - differences(v.clone());
        mean_frames((error / config.target_accel_coherence).square(), &pairs)
    });
    add("quat_delta", config.quat_delta_weight, &|| {
        let (now, next) = ends(q.clone());
        let dot = (now * next).sum_dim(1).abs();
        mean_frames(relu(-dot + config.target_quat_delta), &pairs)
    });
    add("phase_monotonic", config.phase_monotonic_weight, &|| {
        let (now, next) = ends(phase.clone());
        let drop = now - next;
        let punished = match config.phase {
            PhaseLoss::Ccmotion => relu(drop - WRAP),
            PhaseLoss::BackwardSteps => {
                let legal: Tensor<3, Bool> = drop.clone().greater_elem(WRAP);
                relu(drop).mask_fill(legal, 0.0)
            }
        };
        sum_frames(punished, &pairs).mean_dim(0).reshape([1])
    });
    add("quat_norm", config.quat_norm_weight, &|| {
        let excess = q.clone().square().sum_dim(1) - 1.0;
        mean_frames(excess.square(), &frames)
    });
    add("angular_velocity", config.angular_velocity_weight, &|| {
        let error = ends(w.clone()).0 - angular_velocity(q.clone());
        mean_frames((error / config.target_angular_velocity).square(), &pairs)
    });
    add(
        "position_smoothness",
        config.position_smoothness_weight,
        &|| {
            let (now, next) = ends(p.clone());
            let excess = (next - now).abs() - config.position_smoothness_threshold;
            mean_frames(relu(excess), &pairs)
        },
    );
    if time >= 4 {
        add("position_jerk", config.position_jerk_weight, &|| {
            let jerk = differences(differences(differences(p.clone())));
            let square = (jerk / config.target_jerk).square().sum_dim(1);
            let part = |first| frames.clone().narrow(2, first, time - 3);
            mean_frames(square, &(part(0) * part(3)))
        });
    }
    terms
}

/// All frames except the last, and all frames except the first.
fn ends(x: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
    let time = x.dims()[2];
    (x.clone().narrow(2, 0, time - 1), x.narrow(2, 1, time - 1))
}

/// Forward differences per second.
fn differences(x: Tensor<3>) -> Tensor<3> {
    let (now, next) = ends(x);
    (next - now) * FPS
}
