//! The path condition of the network (docs/sources.md, section 7, option C).

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::Root;
use kinegrad_motion::path::PathFeatures;
use kinegrad_train::clips::path_target::root_trajectory;

use crate::network::PATH_CHANNELS;

/// Channels of the root: rotation, x, z, height.
const ROOT: usize = 4;

/// Largest curvature of a condition, radians per meter; the limit is for the sway of standing
/// bodies.
const SHARPEST: f32 = 3.0;

/// The root trajectories of training clips as path conditions.
#[derive(Clone, Debug)]
pub(super) struct RootTrajectories {
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
pub(super) fn of_path(points: &[[f64; 2]], fps: f64, device: &Device) -> Tensor<3> {
    let frames = points.len();
    let values = numbers(points, fps, frames);
    Tensor::from_data(TensorData::new(values, [1, PATH_CHANNELS, frames]), device)
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

    use super::*;

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
