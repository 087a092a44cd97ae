use std::fmt;

use burn::tensor::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::per_sample::per_sample;

/// Smallest distance from t = 0 at which predicted noise is converted to a velocity. For predicted
/// data, the distance is from t = 1. Closer, the factors amplify the network's errors without
/// bound.
pub const NEAREST_END: f64 = 0.05;

/// The quantity that the network of a flow predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FlowPrediction {
    /// `v = x_start - noise`, which is defined at all times.
    #[default]
    Velocity,
    /// The noise.
    Epsilon,
    /// The data.
    Sample,
}

impl fmt::Display for FlowPrediction {
    /// The name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FlowPrediction {
    /// `x_t = (1 - t) noise + t x_start`, with one flow time per sample.
    ///
    /// # Shapes
    /// - noise, x_start, output: `[batch, channels, time]`
    ///
    /// # Panics
    /// Panics unless there is one t per sample.
    pub fn add_noise(noise: Tensor<3>, x_start: Tensor<3>, t: &[f64]) -> Tensor<3> {
        let factor = per_sample(t, &x_start);
        noise.clone() + (x_start - noise) * factor
    }

    /// The training target.
    ///
    /// # Shapes
    /// - noise, x_start, output: `[batch, channels, time]`
    pub fn target(self, noise: Tensor<3>, x_start: Tensor<3>) -> Tensor<3> {
        match self {
            Self::Velocity => x_start - noise,
            Self::Epsilon => noise,
            Self::Sample => x_start,
        }
    }

    /// Converts a prediction of this kind to the kind `to`, for the same `x_t`
    /// (docs/sources.md, section 5):
    ///
    /// ```text
    /// noise = x_t - t v          data = x_t + (1 - t) v
    /// v = (x_t - noise) / t      v = (data - x_t) / (1 - t)
    /// ```
    ///
    /// Noise at t = 0 and data at t = 1 do not determine the velocity: the result is not finite
    /// there.
    ///
    /// # Shapes
    /// - prediction, x_t, output: `[batch, channels, time]`
    ///
    /// # Panics
    /// Panics unless there is one t per sample.
    pub fn convert(self, prediction: Tensor<3>, x_t: Tensor<3>, t: &[f64], to: Self) -> Tensor<3> {
        if self == to {
            return prediction;
        }
        let of = |value: &dyn Fn(f64) -> f64| {
            let values: Vec<f64> = t.iter().map(|&t| value(t)).collect();
            per_sample(&values, &x_t)
        };
        let velocity = match self {
            Self::Velocity => prediction,
            Self::Epsilon => (x_t.clone() - prediction) / of(&|t| t),
            Self::Sample => (prediction - x_t.clone()) / of(&|t| 1.0 - t),
        };
        match to {
            Self::Velocity => velocity,
            Self::Epsilon => x_t.clone() - velocity * of(&|t| t),
            Self::Sample => x_t.clone() + velocity * of(&|t| 1.0 - t),
        }
    }

    /// `t`, clamped to the times at which the prediction determines a velocity.
    pub(super) fn readable(self, t: f64) -> f64 {
        match self {
            Self::Velocity => t,
            Self::Epsilon => t.max(NEAREST_END),
            Self::Sample => t.min(1.0 - NEAREST_END),
        }
    }
}
