use burn::tensor::{Device, TensorData};
use kinegrad_random::{Key, Purpose};

use super::*;
use crate::{DiffusionConfig, PredictionType};

/// Predicts `tanh(weight x + cond)`, scaled by the timestep.
struct Network {
    weight: Tensor<3>,
}

impl Denoiser for Network {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        let scale = 1.0 + time[0].0 / 1000.0;
        (x_t * self.weight.clone() + cond.clone()).tanh() * scale
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.zeros_like()
    }
}

const SHAPE: [usize; 3] = [2, 3, 4];

fn normal(seed: u64) -> Tensor<3> {
    let values = Key::new(seed, Purpose::Noise).normals(SHAPE.iter().product());
    Tensor::from_data(TensorData::new(values, SHAPE), &Device::flex())
}

fn rollout(prediction_type: PredictionType) -> Rollout {
    let config = DiffusionConfig {
        prediction_type,
        ..Default::default()
    };
    Rollout {
        diffusion: GaussianDiffusion::new(&config).unwrap(),
        clip: ClipRange::Symmetric(1.5),
        guidance: 1.0.into(),
        gradient_decay: 1.0,
    }
}

struct Found {
    x: Vec<f32>,
    weight: Vec<f32>,
    start: Vec<f32>,
}

fn host(x: Tensor<3>) -> Vec<f32> {
    x.without_autodiff()
        .into_data()
        .try_to_vec::<f32>()
        .unwrap()
}

fn run(rollout: &Rollout, steps: usize, mode: RolloutMode) -> Found {
    let plain = Network { weight: normal(1) };
    let weight = normal(1).autodiff().require_grad();
    let model = Network {
        weight: weight.clone(),
    };
    let timesteps = rollout_timesteps(&[700, 400], steps);
    let (start, cond) = (normal(2), normal(3));
    let output = rollout
        .run(&model, &plain, start, &cond, &timesteps, mode)
        .unwrap();
    let x = host(output.x.clone());
    let mut gradients = output.x.powi_scalar(3).sum().backward();
    let mut sum = weight
        .grad_remove(&mut gradients)
        .unwrap_or_else(|| normal(0).zeros_like());
    let start = match output.trace {
        None => output.entry.grad_remove(&mut gradients).unwrap(),
        Some(trace) => trace
            .backward(
                rollout,
                &model,
                &cond,
                &mut gradients,
                &mut |_, mut local| {
                    let part = weight.grad_remove(&mut local).unwrap();
                    sum = sum.clone() + part;
                },
            )
            .unwrap(),
    };
    Found {
        x,
        weight: host(sum),
        start: host(start),
    }
}

fn assert_close(what: &str, a: &[f32], b: &[f32]) {
    let scale = b.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= 2e-6 * scale, "{what}: {a} {b}");
    }
}

#[test]
fn checkpointed_gradients_are_those_of_the_full_graph() {
    use PredictionType::{Epsilon, Sample, VPrediction};
    for prediction_type in [Epsilon, Sample, VPrediction] {
        for (guidance_scale, gradient_decay) in [(1.0, 1.0), (2.5, 1.0), (1.0, 0.5)] {
            for clip in [
                ClipRange::Symmetric(1.5),
                straight_through(1.5),
                ClipRange::None,
            ] {
                let rollout = Rollout {
                    clip,
                    guidance: guidance_scale.into(),
                    gradient_decay,
                    ..rollout(prediction_type)
                };
                for steps in [1, 2, 7] {
                    let full = run(&rollout, steps, RolloutMode::Full);
                    let checkpointed = run(&rollout, steps, RolloutMode::Checkpointed);
                    assert_eq!(full.x, checkpointed.x);
                    assert_close("weight", &checkpointed.weight, &full.weight);
                    assert_close("start", &checkpointed.start, &full.start);
                }
            }
        }
    }
}

fn straight_through(bound: f32) -> ClipRange {
    ClipRange::StraightThrough(Box::new(ClipRange::Symmetric(bound)))
}

#[test]
fn the_start_gradient_agrees_with_finite_differences() {
    let rollout = Rollout {
        clip: ClipRange::None,
        ..rollout(PredictionType::Sample)
    };
    let found = run(&rollout, 4, RolloutMode::Full);
    let model = Network { weight: normal(1) };
    let timesteps = rollout_timesteps(&[700, 400], 4);
    let objective = |start: Tensor<3>| -> f64 {
        let output = rollout
            .run(
                &model,
                &model,
                start,
                &normal(3),
                &timesteps,
                RolloutMode::LastK(0),
            )
            .unwrap();
        host(output.x).iter().map(|v| f64::from(*v).powi(3)).sum()
    };
    for index in 0..SHAPE.iter().product() {
        let moved = |step: f32| {
            let mut values = host(normal(2));
            values[index] += step;
            Tensor::from_data(TensorData::new(values, SHAPE), &Device::flex())
        };
        let slope = (objective(moved(1e-2)) - objective(moved(-1e-2))) / 2e-2;
        let gradient = f64::from(found.start[index]);
        assert!((slope - gradient).abs() < 2e-3, "{slope} {gradient}");
    }
}

#[test]
fn all_steps_as_the_last_ones_are_the_full_graph() {
    let rollout = rollout(PredictionType::Epsilon);
    let full = run(&rollout, 5, RolloutMode::Full);
    let last = run(&rollout, 5, RolloutMode::LastK(5));
    assert_eq!((full.weight, full.start), (last.weight, last.start));
    let truncated = run(&rollout, 5, RolloutMode::LastK(1));
    assert_eq!(full.x, truncated.x);
}

#[test]
fn a_straight_through_clip_has_a_gradient_outside() {
    let x = Tensor::<3>::from_floats([[[-3.0, 0.5, 9.0]]], &Device::flex())
        .autodiff()
        .require_grad();
    let y = straight_through(1.0).apply(x.clone()).unwrap();
    assert_eq!(host(y.clone()), [-1.0, 0.5, 1.0]);
    let gradients = y.sum().backward();
    assert_eq!(host(x.grad(&gradients).unwrap()), [1.0; 3]);
}

#[test]
fn each_sample_begins_where_it_is_told() {
    let found = rollout_timesteps(&[999, 100, 0], 5);
    assert_eq!(found[0], [999, 100, 0]);
    assert_eq!(found[1], [749, 75, 0]);
    assert_eq!(found[4], [0, 0, 0]);
    assert_eq!(rollout_timesteps(&[7], 1), [[7]]);
}
