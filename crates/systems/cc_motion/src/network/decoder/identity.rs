//! A decoder that starts as the inverse of the normalization. The input projection has orthonormal
//! columns. Each head recovers its channels from these columns and undoes the normalization. The
//! residual blocks have no effect.

use std::ops::Range;

use kinegrad_models::parameters;
use kinegrad_motion::phrase::{ACCELERATION, POSITION, VELOCITY};

use super::{MotionDecoder, Normalization, OutputActivation};

/// The error is at most 0.06 between 0 and 1; a slope of 4 has a larger error at the ends.
const SIGMOID_SLOPE: f64 = 6.0;

/// Sets the weights of `decoder`; the random input projection gives the directions.
pub(super) fn identity(decoder: MotionDecoder) -> MotionDecoder {
    let mut weights = parameters::export(&decoder);
    let channels = decoder.targets.channels();
    let columns = weights
        .iter()
        .find(|parameter| parameter.info.name == "input_proj.weight")
        .map(|parameter| orthonormal_columns(&parameter.values, channels))
        .expect("a decoder has an input projection");
    for parameter in &mut weights {
        let name = parameter.info.name.as_str();
        let values = &mut parameter.values;
        if name == "input_proj.weight" {
            for (row, values) in values.chunks_mut(channels).enumerate() {
                for (value, column) in values.iter_mut().zip(&columns) {
                    *value = column[row] as f32;
                }
            }
        } else if name == "input_proj.bias" || name.contains(".layers.4.") {
            values.fill(0.0);
        } else if let Some((own, activation, range)) = head(&decoder, name) {
            let start = own.start;
            let Normalization { mean, std } = &decoder.normalization;
            let channel =
                |index| affine(mean[start + index], std[start + index], activation, range);
            if name.ends_with(".bias") {
                for (index, value) in values.iter_mut().enumerate() {
                    *value = channel(index).1 as f32;
                }
            } else {
                let hidden = values.len() / own.len();
                for (index, row) in values.chunks_mut(hidden).enumerate() {
                    let gain = channel(index).0;
                    for (value, direction) in row.iter_mut().zip(&columns[start + index]) {
                        *value = (gain * direction) as f32;
                    }
                }
            }
        }
    }
    let values = weights.into_iter().map(|parameter| parameter.values);
    parameters::replace(decoder, values.collect())
}

/// Channels, activation and range of the head with the parameter `name`.
fn head(decoder: &MotionDecoder, name: &str) -> Option<(Range<usize>, OutputActivation, f64)> {
    let targets = decoder.targets;
    let component = name.split('.').next()?.strip_suffix("_head")?;
    let channels = [
        ("position", POSITION),
        ("velocity", VELOCITY),
        ("acceleration", ACCELERATION),
        ("quaternion", targets.orientation_channels()),
        ("angular_velocity", targets.angular_velocity_channels()),
        ("phase", targets.phase_channels()),
        ("style", targets.style_channels()),
    ];
    let mut heads = channels.into_iter().zip(decoder.bounds());
    heads.find_map(|((name, channels), (activation, range))| {
        (name == component).then_some((channels, activation, range))
    })
}

/// Gain and offset before an activation that give the best approximation of `std x + mean`.
fn affine(mean: f64, std: f64, activation: OutputActivation, range: f64) -> (f64, f64) {
    match activation {
        OutputActivation::None | OutputActivation::Normalize => (std, mean),
        OutputActivation::TanhScaled => (std / range, mean / range),
        OutputActivation::Sigmoid => (SIGMOID_SLOPE * std, SIGMOID_SLOPE * (mean - 0.5)),
    }
}

/// The columns of a row-major matrix with `channels` columns, made orthonormal from left to right.
fn orthonormal_columns(values: &[f32], channels: usize) -> Vec<Vec<f64>> {
    let mut columns: Vec<Vec<f64>> = Vec::with_capacity(channels);
    for channel in 0..channels {
        let mut column: Vec<f64> = values
            .chunks(channels)
            .map(|row| f64::from(row[channel]))
            .collect();
        for earlier in &columns {
            let dot: f64 = column.iter().zip(earlier).map(|(a, b)| a * b).sum();
            for (value, direction) in column.iter_mut().zip(earlier) {
                *value -= dot * direction;
            }
        }
        let norm = column.iter().map(|v| v * v).sum::<f64>().sqrt();
        column.iter_mut().for_each(|value| *value /= norm);
        columns.push(column);
    }
    columns
}
