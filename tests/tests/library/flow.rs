//! A small flow model learns to continue walking.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::humanml::walk;
use kinegrad_diffusion::{FlowPrediction, LossType, SamplerConfig, SamplerKind, diffusion_loss};
use kinegrad_flow::network::FlowConfig;
use kinegrad_flow::network::{
    FlowCondition, FlowModel, FlowRollout, FlowSpace, History, RolloutSettings, previous_state,
};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_motion::humanml::{FeatureStream, Joints, NextPose, Skeleton};
use kinegrad_motion::{ChannelMoments, Statistics};
use kinegrad_random::{Key, Purpose};

/// Rows of a history.
const HISTORY: usize = 15;
const BATCH: usize = 32;
const STEPS: usize = 200;
/// Frames of each walk.
const FRAMES: usize = 120;

/// The raw rows of a walk, and its joints.
fn rows_of(index: usize) -> (Vec<Vec<f32>>, Joints) {
    let joints = walk(index, FRAMES, 3).features.joints();
    let mut stream = FeatureStream::new(Skeleton::humanml3d(), 0.002).expect("valid");
    let rows = (0..joints.frames())
        .filter_map(|t| stream.push(joints.frame(t)).expect("a frame"))
        .collect();
    (rows, joints)
}

/// Histories with the pose that follows each, normalised.
struct Windows {
    /// `[BATCH, 263, HISTORY]`
    frames: Tensor<3>,
    /// `[BATCH, 3, 22]`
    next: Tensor<3>,
    progress: Tensor<1>,
}

impl Windows {
    fn draw(walks: &[Vec<Vec<f32>>], space: &FlowSpace, key: Key, device: &Device) -> Self {
        let chosen = key.at(0).integers(BATCH, walks.len());
        let starts = key.at(1).integers(BATCH, walks[0].len() - HISTORY);
        let (mut frames, mut next, mut progress) = (Vec::new(), Vec::new(), Vec::new());
        for (walk, start) in chosen.into_iter().zip(starts) {
            let rows = &walks[walk][start..start + HISTORY];
            frames.extend(rows.iter().flat_map(|row| space.features.normalize(row)));
            let target = space.next.of_row(&walks[walk][start + HISTORY]);
            next.extend(space.target.normalize(&target.expect("a row")));
            progress.push(1.0 - start as f32 / (walks[walk].len() - HISTORY) as f32);
        }
        let tensor = |values, shape: [usize; 3]| -> Tensor<3> {
            Tensor::from_data(TensorData::new(values, shape), device).swap_dims(1, 2)
        };
        Self {
            frames: tensor(frames, [BATCH, HISTORY, 263]),
            next: tensor(next, [BATCH, 22, 3]),
            progress: Tensor::from_data(TensorData::new(progress, [BATCH]), device),
        }
    }
}

/// The loss of a batch.
fn loss_of(model: &FlowModel, windows: Windows, key: Key, device: &Device) -> Tensor<1> {
    let last = windows.frames.clone().narrow(2, HISTORY - 1, 1);
    let cond = FlowCondition {
        context: model.encoder.forward(History {
            frames: windows.frames,
            lengths: vec![HISTORY; BATCH],
            text: Tensor::zeros([BATCH, 512], device),
            duration: None,
        }),
        null_context: None,
        previous: previous_state(last.squeeze_dim(2)),
        progress: windows.progress,
    };
    let noise = TensorData::new(key.at(2).normals(BATCH * 66), [BATCH, 3, 22]);
    let noise = Tensor::<3>::from_data(noise, device);
    let times = key.at(3).uniforms(BATCH);
    let t: Vec<f64> = times.iter().copied().map(f64::from).collect();
    let x_t = FlowPrediction::add_noise(noise.clone(), windows.next.clone(), &t);
    let times = Tensor::from_data(TensorData::new(times, [BATCH]), device);
    let v = model.predictor.forward(x_t, times, &cond);
    let target = FlowPrediction::Velocity.target(noise, windows.next);
    diffusion_loss(v, target, None, None, LossType::Mse)
}

/// Adam's moments of all parameters.
struct Adam(Vec<[Vec<f32>; 2]>);

impl Adam {
    fn step(&mut self, values: &mut [Vec<f32>], gradients: &[Vec<f32>], step: usize) {
        let bias = |beta: f32| 1.0 - beta.powi(step as i32 + 1);
        for ((values, gradients), [mean, square]) in
            values.iter_mut().zip(gradients).zip(&mut self.0)
        {
            for (((value, g), m), s) in values.iter_mut().zip(gradients).zip(mean).zip(square) {
                *m = 0.9 * *m + 0.1 * g;
                *s = 0.99 * *s + 0.01 * g * g;
                *value -= 2e-3 * (*m / bias(0.9)) / ((*s / bias(0.99)).sqrt() + 1e-8);
            }
        }
    }
}

/// The losses of a training and the trained model.
fn trained(next: NextPose, walks: &[Vec<Vec<f32>>]) -> (Vec<f32>, FlowModel, FlowSpace) {
    let targets = walks.iter().map(|rows| {
        let of_rows = rows.iter().map(|row| next.of_row(row).expect("a row"));
        of_rows.flatten().collect()
    });
    let targets: Vec<Vec<f32>> = targets.collect();
    let rows: Vec<Vec<f32>> = walks.iter().map(|rows| rows.concat()).collect();
    let measure = |channels, items: &[Vec<f32>]| {
        let items = items.iter().map(Vec::as_slice);
        Statistics::standard(ChannelMoments::measure(channels, items))
    };
    let space = FlowSpace {
        features: measure(263, &rows),
        target: measure(66, &targets),
        next,
        prediction: FlowPrediction::Velocity,
        history: HISTORY,
        longest: 196,
        skeleton: Skeleton::humanml3d(),
    };
    let device = Device::flex().autodiff();
    let init = Initializer::new(1, &device);
    let mut model = FlowConfig::tiny()
        .init(&space.skeleton, &init)
        .expect("networks");
    let mut values = parameters::values(&model);
    let zeros = |values: &Vec<f32>| [vec![0.0; values.len()], vec![0.0; values.len()]];
    let mut adam = Adam(values.iter().map(zeros).collect());
    let losses = (0..STEPS).map(|step| {
        let key = Key::new(1, Purpose::Noise).at(step as u64);
        let windows = Windows::draw(walks, &space, key, &device);
        let loss = loss_of(&model, windows, key, &device);
        let value = loss.clone().into_scalar::<f32>();
        let gradients = kinegrad_models::gradients(&model, &mut loss.backward());
        adam.step(&mut values, &gradients, step);
        model = parameters::replace(model.clone(), values.clone());
        value
    });
    let losses = losses.collect();
    (losses, model.valid(), space)
}

/// Path length of the root on the ground, metres.
fn way(frames: &[Vec<[f64; 3]>]) -> f64 {
    let steps = frames.windows(2).map(|pair| {
        let [a, b] = [pair[0][0], pair[1][0]];
        (b[0] - a[0]).hypot(b[2] - a[2])
    });
    steps.sum()
}

#[test]
fn a_small_model_learns_to_go_on_walking() {
    let all: Vec<(Vec<Vec<f32>>, Joints)> = (0..17).map(rows_of).collect();
    let (held_out, seen) = all.split_last().expect("walks");
    let walks: Vec<Vec<Vec<f32>>> = seen.iter().map(|(rows, _)| rows.clone()).collect();
    for next in [NextPose::Position, NextPose::Displacement] {
        let (losses, model, space) = trained(next, &walks);
        let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
        let (first, last) = (mean(&losses[..10]), mean(&losses[STEPS - 40..]));
        println!("{next}: loss {first} to {last}");
        // For data and noise of unit variance, predicting 0 has a loss of 2.
        assert!(last < 0.5 * first, "{next}: {first} to {last}");

        let truth: Vec<Vec<[f64; 3]>> = (HISTORY..HISTORY + 40)
            .map(|t| held_out.1.frame(t).to_vec())
            .collect();
        let history = held_out.1.as_slice()[..(HISTORY + 1) * 22].to_vec();
        let history = Joints::new(history, 22).expect("frames");
        let settings = RolloutSettings {
            sampler: SamplerConfig::new(SamplerKind::Euler, 10),
            frames: 40,
            constant_bones: true,
            same_noise: false,
            contact_threshold: 0.002,
        };
        let (key, device) = (Key::new(5, Purpose::Sampling), Device::flex());
        let rollout = FlowRollout::new(model, space, settings, &history, key, &device);
        let mut rollout = rollout.expect("a history");
        let frames: Vec<Vec<[f64; 3]>> =
            std::iter::from_fn(|| rollout.next_frame().expect("finite")).collect();
        let (found, expected) = (way(&frames), way(&truth));
        println!("{next}: way {found} of {expected} m");
        assert!(
            (0.3..3.0).contains(&(found / expected)),
            "{next}: {found} of {expected} m"
        );
        let lowest = frames
            .iter()
            .flatten()
            .map(|place| place[1])
            .fold(f64::INFINITY, f64::min);
        let highest = frames.iter().map(|frame| frame[0][1]).fold(0.0, f64::max);
        println!("{next}: lowest {lowest}, root up to {highest}");
        assert!(
            lowest > -0.5 && highest < 1.5,
            "{next}: {lowest} to {highest} m"
        );
    }
}
