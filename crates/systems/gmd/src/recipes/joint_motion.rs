//! A loss of the joints' motion in the world.

use burn::tensor::{Int, Tensor, TensorData};
use kinegrad_motion::Statistics;
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::humanml::{FeatureLayout, Skeleton};
use kinegrad_train::clips::space::rows_to_motion;

use crate::GmdLossConfig;

/// The target's contact flags above this value mark standing feet.
const STANDING: f32 = 0.5;

/// The velocity and foot contact losses of the Human Motion Diffusion Model (Tevet et al. 2022,
/// <https://arxiv.org/abs/2209.14916>, equations 4 and 5) for features with an absolute root:
///
/// ```text
/// L = joint_velocity  mean over frames of  sum over joints |v - v_target|^2 / J
///   + foot_contact    mean over frames of  sum over feet   c_target |v|^2 / 4
/// ```
///
/// v is a joint's velocity in the world from one frame to the next, in meters per second; c is the
/// contact flag of the first frame. The features split a joint's position into the root's position
/// and the position relative to the root, in the facing frame. Both may be nearly right while a
/// standing foot slides.
#[derive(Clone, Debug)]
pub struct JointMotion {
    joint_velocity: f64,
    foot_contact: f64,
    /// The affine map from the network's channels to root, positions and contact flags, `[rows,
    /// channels]`.
    rows: Vec<f32>,
    offsets: Vec<f32>,
    channels: usize,
    layout: FeatureLayout,
    feet: [usize; 4],
    fps: f64,
}

impl JointMotion {
    /// The loss for features of `skeleton`; `None` if both weights are 0.
    pub fn new(
        loss: &GmdLossConfig,
        skeleton: &Skeleton,
        statistics: &Statistics,
        projection: Option<&EmphasisProjection>,
    ) -> Option<Self> {
        if loss.joint_velocity == 0.0 && loss.foot_contact == 0.0 {
            return None;
        }
        let layout = skeleton.layout();
        let channels = layout.channels();
        let positions = FeatureLayout::ROOT.chain(layout.positions());
        let wanted: Vec<usize> = positions.chain(layout.contacts()).collect();
        let offset = |&row: &usize| statistics.mean[row] as f32;
        Some(Self {
            joint_velocity: loss.joint_velocity,
            foot_contact: loss.foot_contact,
            rows: rows_to_motion(&wanted, &statistics.std, projection),
            offsets: wanted.iter().map(offset).collect(),
            channels,
            layout,
            feet: skeleton.contact_joints(),
            fps: skeleton.description().fps,
        })
    }

    /// The weighted terms.
    ///
    /// # Shapes
    /// - prediction, target: clean motion in the network's space, `[batch, channels, time]`
    /// - mask: `[batch, time]`, 1 where a frame is real; a sample of one real frame counts as 0
    pub fn terms(
        &self,
        prediction: Tensor<3>,
        target: Tensor<3>,
        mask: Tensor<2>,
    ) -> Vec<(&'static str, Tensor<1>)> {
        let [batch, _, time] = prediction.dims();
        if time < 2 {
            return Vec::new();
        }
        let joints = self.layout.joints();
        let (velocities, _) = self.velocities(prediction);
        let (expected, contacts) = self.velocities(target);
        // A velocity is real if its second frame is real.
        let real = mask.narrow(1, 1, time - 1);
        let over_frames = |of_frames: Tensor<3>, weight: f64| {
            let of_frames = of_frames.sum_dim(1).reshape([batch, time - 1]) * real.clone();
            let steps = real.clone().sum_dim(1).clamp_min(1.0);
            (of_frames.sum_dim(1) / steps).sum() * (weight / batch as f64)
        };
        let mut terms = Vec::new();
        if self.joint_velocity > 0.0 {
            let errors = (velocities.clone() - expected).powi_scalar(2);
            let weight = self.joint_velocity / joints as f64;
            terms.push(("joint_velocity", over_frames(errors, weight)));
        }
        if self.foot_contact > 0.0 {
            let device = velocities.device();
            let of_axis = |axis: usize| self.feet.map(|foot| (axis * joints + foot) as i32);
            let chosen: Vec<i32> = (0..3).flat_map(of_axis).collect();
            let chosen = Tensor::<1, Int>::from_data(TensorData::new(chosen, [12]), &device);
            let squares = velocities.select(1, chosen).powi_scalar(2);
            let stands = contacts.greater_scalar(STANDING).float();
            let stands = stands.narrow(2, 0, time - 1).repeat_dim(1, 3);
            let weight = self.foot_contact / 4.0;
            terms.push(("foot_contact", over_frames(squares * stands, weight)));
        }
        terms
    }

    /// World velocities of the joints in meters per second, `[batch, 3 J, time - 1]`, and contact
    /// flags, `[batch, 4, time]`. The velocities along x of all joints are first.
    fn velocities(&self, x: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let [batch, _, time] = x.dims();
        let device = x.device();
        let count = self.offsets.len();
        let rows = TensorData::new(self.rows.clone(), [1, count, self.channels]);
        let offsets = TensorData::new(self.offsets.clone(), [1, count, 1]);
        let rows = Tensor::<3>::from_data(rows, &device);
        let motion = rows.matmul(x) + Tensor::<3>::from_data(offsets, &device);
        let root = |channel: usize| motion.clone().narrow(1, channel, 1);
        let bodies = self.layout.joints() - 1;
        let end = FeatureLayout::ROOT.end;
        let places = motion.clone().narrow(1, end, 3 * bodies);
        let places = places.reshape([batch, bodies, 3, time]);
        let along = |axis| {
            places
                .clone()
                .narrow(2, axis, 1)
                .reshape([batch, bodies, time])
        };
        let [x, y, z] = [along(0), along(1), along(2)];
        // The inverse of the root quaternion, which rotates the world into the facing frame.
        let angle = root(0) * 2.0;
        let (cos, sin) = (angle.clone().cos(), angle.sin());
        let world_x = x.clone() * cos.clone() - z.clone() * sin.clone() + root(1);
        let world_z = x * sin + z * cos + root(2);
        let world = Tensor::cat(vec![root(1), world_x, root(3), y, root(2), world_z], 1);
        let [later, earlier] = [1, 0].map(|first| world.clone().narrow(2, first, time - 1));
        let contacts = motion.narrow(1, end + 3 * bodies, 4);
        ((later - earlier) * self.fps, contacts)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisKind};
    use kinegrad_motion::humanml::{Features, Root};
    use kinegrad_random::{Key, Purpose};

    use super::*;

    const FRAMES: usize = 12;

    fn weighing(joint_velocity: f64, foot_contact: f64) -> GmdLossConfig {
        GmdLossConfig {
            joint_velocity,
            foot_contact,
            ..GmdLossConfig::default()
        }
    }

    /// Arbitrary features that turn by more than half a circle, with feet on the floor in every
    /// second frame; and the same features in the network's space.
    struct Example {
        features: Features,
        network: Tensor<3>,
        statistics: Statistics,
        projection: EmphasisProjection,
    }

    impl Example {
        fn new(seed: u64) -> Self {
            let skeleton = Skeleton::humanml3d();
            let channels = skeleton.layout().channels();
            let mut values = Key::new(seed, Purpose::Synthetic).normals(FRAMES * channels);
            for (t, frame) in values.chunks_exact_mut(channels).enumerate() {
                frame[0] = 0.3 * t as f32;
                frame[skeleton.layout().contacts()].fill(f32::from(u8::from(t % 2 == 0)));
            }
            let features =
                Features::new(values.clone(), skeleton.layout(), Root::Absolute).unwrap();
            let mean: Vec<f64> = (0..channels).map(|c| 0.01 * c as f64).collect();
            let std: Vec<f64> = (0..channels).map(|c| 0.5 + 0.01 * c as f64).collect();
            let statistics = Statistics::new(mean, std, Some(Root::Absolute)).unwrap();
            let config = EmphasisConfig {
                kind: EmphasisKind::Orthogonal,
                ..EmphasisConfig::default()
            };
            let projection = config.projection(channels).unwrap().expect("a projection");
            let network = network(&values, &statistics, &projection);
            Self {
                features,
                network,
                statistics,
                projection,
            }
        }

        fn loss(&self, config: &GmdLossConfig) -> Option<JointMotion> {
            let skeleton = Skeleton::humanml3d();
            JointMotion::new(config, &skeleton, &self.statistics, Some(&self.projection))
        }

        /// Velocity of a joint from frame t to frame t + 1.
        fn velocity(&self, t: usize, joint: usize) -> [f64; 3] {
            let joints = self.features.joints();
            let (here, there) = (joints.frame(t)[joint], joints.frame(t + 1)[joint]);
            [0, 1, 2].map(|axis| (there[axis] - here[axis]) * 20.0)
        }
    }

    /// Frames in the space of a network, `[1, channels, frames]`.
    fn network(
        frames: &[f32],
        statistics: &Statistics,
        projection: &EmphasisProjection,
    ) -> Tensor<3> {
        let channels = statistics.channels();
        let normalized = frames.iter().enumerate().map(|(index, &value)| {
            let channel = index % channels;
            ((f64::from(value) - statistics.mean[channel]) / statistics.std[channel]) as f32
        });
        let projected = projection.project(&normalized.collect::<Vec<f32>>());
        let data = TensorData::new(projected, [1, frames.len() / channels, channels]);
        Tensor::<3>::from_data(data, &Device::flex()).swap_dims(1, 2)
    }

    fn value(term: &Tensor<1>) -> f64 {
        f64::from(term.clone().into_scalar::<f32>())
    }

    #[test]
    fn terms_are_those_of_the_joints_in_the_world() {
        let (found, target) = (Example::new(1), Example::new(2));
        // Prediction and target in the same space.
        let network = network(
            target.features.as_slice(),
            &found.statistics,
            &found.projection,
        );
        let target = Example { network, ..target };
        let loss = found.loss(&weighing(0.5, 3.0)).expect("weights");
        let real = 9;
        let mask: Vec<f32> = (0..FRAMES).map(|t| f32::from(u8::from(t < real))).collect();
        let mask = Tensor::<2>::from_data(TensorData::new(mask, [1, FRAMES]), &Device::flex());
        let terms = loss.terms(found.network.clone(), target.network.clone(), mask);
        let (mut velocity, mut contact) = (0.0, 0.0);
        for t in 0..real - 1 {
            for joint in 0..22 {
                let (a, b) = (found.velocity(t, joint), target.velocity(t, joint));
                let error = |axis: usize| (a[axis] - b[axis]).powi(2);
                velocity += (error(0) + error(1) + error(2)) / 22.0;
                if t % 2 == 0 && [7, 8, 10, 11].contains(&joint) {
                    contact += a.iter().map(|v| v * v).sum::<f64>() / 4.0;
                }
            }
        }
        let expected = [0.5 * velocity / 8.0, 3.0 * contact / 8.0];
        for ((name, term), expected) in terms.iter().zip(expected) {
            let found = value(term);
            assert!(
                (found / expected - 1.0).abs() < 1e-4,
                "{name}: {found}, {expected}"
            );
        }
        assert_eq!(terms.len(), 2);
    }

    #[test]
    fn the_target_itself_moves_as_it_does() {
        let example = Example::new(3);
        let mask = Tensor::ones([1, FRAMES], &Device::flex());
        let loss = example.loss(&weighing(1.0, 0.0)).expect("a weight");
        let x = example.network.clone();
        let terms = loss.terms(x.clone(), x.clone(), mask);
        assert_eq!(terms.len(), 1);
        assert_eq!(value(&terms[0].1), 0.0);
        assert!(example.loss(&weighing(0.0, 0.0)).is_none());
        let one = x.narrow(2, 0, 1);
        let mask = Tensor::ones([1, 1], &Device::flex());
        assert!(loss.terms(one.clone(), one, mask).is_empty());
    }
}
