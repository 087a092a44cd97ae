//! Root paths as a condition of networks (docs/sources.md, section 7, option C).

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_models::DropoutKey;
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::Root;
use kinegrad_motion::path::PathFeatures;
use kinegrad_settings::{InvalidSetting, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::path_target::root_trajectory;

/// Channels of a path in a frame: position x and z, meters; velocity along x and z, meters per
/// second; sine and cosine of the heading; curvature, 1 / meter.
pub const PATH_CHANNELS: usize = 7;

/// Place of the path's tokens, one per frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathTokens {
    /// Added to the frames' tokens. An untrained path changes nothing.
    #[default]
    Added,
    /// Concatenated to the condition of text and timestep, on which the queries of each layer
    /// depend. An untrained path changes nothing. Not for `kind = "mdm_transformer"`, whose
    /// condition is one token.
    Concatenated,
    /// Additional rows of the sequence, to which the frames attend: twice the work. Frames without
    /// a path attend to no row.
    Rows,
}

/// The table `paths`: training of a path-conditioned network (`model.path`).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PathTrainingConfig {
    /// Probability of dropping a training sample's path. 0.1 also trains the network without paths.
    /// Recipe `path_adapter` needs no dropping, because its base was trained without paths.
    pub drop_prob: f64,
}

impl PathTrainingConfig {
    /// Checks the table for a network with or without a path.
    ///
    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self, has_path: bool) -> Result<(), InvalidSetting> {
        let (key, prob) = ("paths.drop_prob", self.drop_prob);
        in_range(key, prob, 0.0..=1.0)?;
        let allowed = "0 without `model.path`";
        require(prob == 0.0 || has_path, key, prob, allowed)
    }

    /// The mask of a training step, `[batch, 1, 1]`: 0 for dropped paths, else 1; `None` without
    /// dropping.
    pub fn mask(&self, key: DropoutKey, batch: usize, device: &Device) -> Option<Tensor<3>> {
        let key = key.filter(|_| self.drop_prob > 0.0)?.named("path");
        let uniforms = key.uniforms(batch).into_iter();
        let mask = uniforms.map(|u| f32::from(f64::from(u) >= self.drop_prob));
        let data = TensorData::new(mask.collect(), [batch, 1, 1]);
        Some(Tensor::from_data(data, device))
    }
}

/// True for the motions of a mask `[batch, 1, 1]` that keep their path; all without a mask.
pub fn kept_by(mask: Option<&Tensor<3>>, batch: usize) -> Vec<bool> {
    match mask {
        None => vec![true; batch],
        Some(mask) => {
            let mask = mask.clone().try_into_vec_as::<f32>().expect("float32");
            mask.into_iter().map(|value| value > 0.0).collect()
        }
    }
}

/// Channels of the root: rotation, x, z, height.
const ROOT: usize = 4;

/// Largest curvature of a condition, radians per meter; the limit is for the sway of standing
/// bodies.
const SHARPEST: f32 = 3.0;

/// The root trajectories of training clips as path conditions.
#[derive(Clone, Debug)]
pub struct RootTrajectories {
    root: Root,
    mean: Vec<f64>,
    std: Vec<f64>,
    fps: f64,
}

impl RootTrajectories {
    /// For clips normalized by `statistics`, with `fps` frames per second.
    pub fn new(root: Root, statistics: &Statistics, fps: f64) -> Self {
        Self {
            root,
            mean: statistics.mean[..ROOT].to_vec(),
            std: statistics.std[..ROOT].to_vec(),
            fps,
        }
    }

    /// The path conditions of a batch of clips with the given lengths; padding has zeros.
    ///
    /// # Shapes
    /// - x_start: `[batch, channels, time]`
    /// - output: `[batch, PATH_CHANNELS, time]`
    pub fn conditions(&self, x_start: &Tensor<3>, lengths: &[usize]) -> Tensor<3> {
        let [batch, _, time] = x_start.dims();
        let values = x_start.clone().narrow(1, 0, ROOT).try_into_vec_as::<f32>();
        let values = values.expect("motion is float32");
        let mut conditions = Vec::with_capacity(batch * PATH_CHANNELS * time);
        for (clip, &length) in values.chunks_exact(ROOT * time).zip(lengths) {
            let frame = |t: usize| {
                [0, 1, 2, 3].map(|c| f64::from(clip[c * time + t]) * self.std[c] + self.mean[c])
            };
            let rows: Vec<[f64; ROOT]> = (0..length).map(frame).collect();
            let track = root_trajectory(&self.root.positions(&rows), self.fps);
            conditions.extend(numbers(&track, self.fps, time));
        }
        let data = TensorData::new(conditions, [batch, PATH_CHANNELS, time]);
        Tensor::from_data(data, &x_start.device())
    }
}

/// The condition of one path with a point per frame: `[1, PATH_CHANNELS, frames]`.
pub fn of_path(points: &[[f64; 2]], fps: f64, device: &Device) -> Tensor<3> {
    of_paths(&[points], fps, points.len(), device)
}

/// The conditions of paths with a point per frame, `[paths, PATH_CHANNELS, time]`, zeros behind a
/// path's end.
///
/// # Panics
/// If a path has more than `time` points.
pub fn of_paths(paths: &[&[[f64; 2]]], fps: f64, time: usize, device: &Device) -> Tensor<3> {
    let values: Vec<f32> = paths
        .iter()
        .flat_map(|path| numbers(path, fps, time))
        .collect();
    let shape = [paths.len(), PATH_CHANNELS, time];
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// The values of all frames, channel by channel, padded with zeros to `time`.
fn numbers(track: &[[f64; 2]], fps: f64, time: usize) -> Vec<f32> {
    let features = PathFeatures::of(track);
    let mut values = vec![0.0; PATH_CHANNELS * time];
    for (t, features) in features.into_iter().enumerate() {
        let PathFeatures {
            position: [x, z],
            step: [dx, dz],
            heading,
            curvature,
        } = features;
        let values_of_frame = [x, z, dx * fps, dz * fps, heading.sin(), heading.cos()];
        let curvature = (curvature as f32).clamp(-SHARPEST, SHARPEST);
        let values_of_frame = values_of_frame.map(|value| value as f32).into_iter();
        for (channel, value) in values_of_frame.chain([curvature]).enumerate() {
            values[channel * time + t] = value;
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::path::root_channels;
    use kinegrad_random::{Key, Purpose};

    use super::*;

    #[test]
    fn paths_are_dropped_as_often_as_asked() {
        let mean_of = |key, drop_prob| {
            let paths = PathTrainingConfig { drop_prob };
            let mask = paths.mask(key, 64, &Device::flex())?;
            let kept = kept_by(Some(&mask), 64).into_iter().filter(|kept| *kept);
            let (count, mean) = (kept.count() as f32, mask.mean().into_scalar::<f32>());
            assert!((count / 64.0 - mean).abs() < 1e-6);
            Some(mean)
        };
        let key = Key::new(1, Purpose::Dropout);
        let mean = (0..50).map(|step| mean_of(Some(key.at(step)), 0.1).expect("a key"));
        assert!((mean.sum::<f32>() / 50.0 - 0.9).abs() < 0.02);
        assert_eq!((mean_of(Some(key), 0.0), mean_of(None, 0.1)), (None, None));
    }

    #[test]
    fn conditions_are_the_paths_of_clips_for_both_roots_and_with_padding() {
        // A quarter of a circle of 4 m, with 60 and 40 of 64 frames, relative to the start facing
        // +z.
        let device = Device::flex();
        let track = |frames: usize| -> Vec<[f64; 2]> {
            let angle = |t: usize| t as f64 / 60.0 * std::f64::consts::FRAC_PI_2;
            let place = |t: usize| [4.0 - 4.0 * angle(t).cos(), 4.0 * angle(t).sin()];
            (0..frames).map(place).collect()
        };
        let time = 64;
        for root in [Root::Absolute, Root::Relative] {
            let statistics = Statistics::new(
                vec![0.1, -0.2, 0.3, 0.9, 0.0],
                vec![0.5, 2.0, 3.0, 0.1, 1.0],
                None,
            )
            .unwrap();
            let mut values = Vec::new();
            for frames in [60, 40] {
                let headings: Vec<f64> = (0..frames).map(|t| 0.3 + 0.02 * t as f64).collect();
                // A relative root begins with heading 0.
                let headings: Vec<f64> = match root {
                    Root::Absolute => headings,
                    Root::Relative => headings.iter().map(|h| h - 0.3).collect(),
                };
                let rows = root_channels(&track(frames), &headings, root);
                let mut clip = vec![0.0f32; 5 * time];
                for (t, row) in rows.iter().enumerate() {
                    for (c, value) in row.iter().enumerate() {
                        let normalised = (value - statistics.mean[c]) / statistics.std[c];
                        clip[c * time + t] = normalised as f32;
                    }
                }
                values.extend(clip);
            }
            let x = Tensor::from_data(TensorData::new(values, [2, 5, time]), &device);
            let trajectories = RootTrajectories::new(root, &statistics, 20.0);
            let conditions = trajectories.conditions(&x, &[60, 40]);
            for (clip, frames) in [(0, 60), (1, 40)] {
                let own = conditions.clone().narrow(0, clip, 1);
                let own = own.narrow(2, 0, frames).try_into_vec_as::<f32>().unwrap();
                let path = of_path(&track(frames), 20.0, &device);
                let path = path.try_into_vec_as::<f32>().unwrap();
                for (index, (own, path)) in own.iter().zip(&path).enumerate() {
                    let (channel, t) = (index / frames, index % frames);
                    // Curvature uses second differences, which are one-sided at the ends.
                    if channel < 6 || (10..frames - 10).contains(&t) {
                        assert!(
                            (own - path).abs() < 0.02,
                            "{root:?} {channel} {t}: {own} {path}"
                        );
                    }
                }
            }
            let behind = conditions.narrow(0, 1, 1).narrow(2, 40, 24).abs().max();
            assert_eq!(behind.into_scalar::<f32>(), 0.0);
        }
    }
}
