//! The same network on two devices.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_cc_motion::network::UNet1dConfig;
use kinegrad_diffusion::Time;
use kinegrad_kernels::optimizer::{AdamW, AdamWState, AdamWTensors};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::device;

/// The smallest UNet that its 32 groups allow, with every kind of block.
pub fn tiny() -> UNet1dConfig {
    UNet1dConfig {
        model_channels: 32,
        channel_mult: vec![1, 2],
        num_res_blocks: 1,
        attention_levels: Some(vec![1]),
        num_heads: 8,
        use_scale_shift_norm: true,
        time_embed_dim: 32,
        context_dim: 32,
        dropout: 0.1,
        ..UNet1dConfig::default()
    }
}

/// Output, loss and gradient norms of the tiny network with fixed weights and inputs.
struct Outcome {
    output: Vec<f32>,
    loss: f32,
    gradients: Vec<(String, Vec<f32>)>,
}

fn run(device: &Device) -> Outcome {
    let device = device.clone().autodiff();
    let model = tiny()
        .init(25, 163, &Initializer::new(3, &device))
        .expect("a valid network");
    let key = Key::new(5, Purpose::Noise);
    let tensor = |index: u64, shape: [usize; 3]| -> Tensor<3> {
        let values = key.at(index).normals(shape.iter().product());
        Tensor::from_data(TensorData::new(values, shape), &device)
    };
    let (x, cond, target) = (
        tensor(0, [2, 25, 9]),
        tensor(1, [2, 163, 9]),
        tensor(2, [2, 25, 9]),
    );
    let dropout = Some(Key::new(5, Purpose::Dropout));
    let y = model.forward(x, &Time::of(&[3, 700]), cond, dropout);
    let output = y.clone().inner().try_into_vec_as::<f32>().expect("float32");
    let loss = (y - target).square().mean();
    let mut tracked = loss.backward();
    let names = parameters::infos(&model).into_iter().map(|info| info.name);
    let gradients = names
        .zip(kinegrad_models::gradients(&model, &mut tracked))
        .collect();
    Outcome {
        output,
        loss: loss.into_scalar::<f32>(),
        gradients,
    }
}

fn error(actual: &[f32], reference: &[f32]) -> f32 {
    let scale = reference.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let worst = actual
        .iter()
        .zip(reference)
        .fold(0.0f32, |m, (a, r)| m.max((a - r).abs()));
    assert!(
        actual.iter().all(|v| v.is_finite()),
        "a value is not finite"
    );
    // Gradients that vanish by construction contain only rounding noise.
    if scale < 1e-6 { worst } else { worst / scale }
}

/// Asserts that forward pass and all gradients on the device called `name` agree with the CPU's.
///
/// # Panics
/// Panics if the device cannot be opened or a value differs by more than single precision allows.
pub fn assert_parity(name: &str) {
    let (cpu, _) = device::open("cpu").expect("the CPU");
    let (other, _) = device::open(name).unwrap_or_else(|error| panic!("{error}"));
    let (reference, actual) = (run(&cpu), run(&other));
    let forward = error(&actual.output, &reference.output);
    assert!(forward < 2e-5, "{name}: the output differs by {forward:e}");
    assert!((actual.loss - reference.loss).abs() < 1e-5 * reference.loss.abs());
    let mut worst = 0.0f32;
    for ((parameter, actual), (_, reference)) in actual.gradients.iter().zip(&reference.gradients) {
        let difference = error(actual, reference);
        assert!(
            difference < 2e-4,
            "{name}: the gradient of {parameter} differs by {difference:e}"
        );
        worst = worst.max(difference);
    }
    println!("{name}: output differs by {forward:.1e}, gradients by at most {worst:.1e}");
}

/// Asserts that 100 optimiser steps on the device called `name` give the results of those in main
/// memory for the same gradients: weights, moving average and both moments.
///
/// # Panics
/// Panics if the device cannot be opened or a value differs by more than 1e-6 of the largest.
pub fn assert_optimizer_parity(name: &str) {
    let (device, _) = device::open(name).unwrap_or_else(|error| panic!("{error}"));
    let (len, steps) = (1_003, 100);
    let key = Key::new(7, Purpose::Synthetic);
    let mut host = [key.at(0).normals(len), vec![0.0; len], vec![0.0; len]];
    let mut average = host[0].clone();
    let row = |values: &[f32]| Tensor::from_data(TensorData::new(values.to_vec(), [len]), &device);
    let mut other = AdamWTensors {
        parameter: row(&host[0]),
        exp_avg: row(&host[1]),
        exp_avg_sq: row(&host[2]),
        ema: None,
    };
    let mut other_average = row(&average);
    for step in 1..=steps {
        let numbers = AdamW {
            betas: [0.9, 0.999],
            eps: 1e-8,
            weight_decay: 0.01,
            learning_rate: 1e-3,
            steps: step,
            gradient_scale: 0.7,
        };
        // The same sign for several steps, so that the weights move.
        let mut gradient = key.at(step).normals(len);
        gradient.iter_mut().for_each(|value| *value += 0.5);
        // As with `ema.update_every = 2`.
        let moves = step % 2 == 0;
        let [parameter, exp_avg, exp_avg_sq] = &mut host;
        let state = AdamWState {
            parameter,
            exp_avg,
            exp_avg_sq,
            ema: moves.then_some((&mut average[..], 0.05)),
        };
        numbers.update(state, &gradient);
        other.ema = moves.then(|| (other_average.clone(), 0.05));
        other = numbers.update_tensors(other, row(&gradient));
        if let Some((average, _)) = other.ema.take() {
            other_average = average;
        }
    }
    let found = [
        other.parameter,
        other.exp_avg,
        other.exp_avg_sq,
        other_average,
    ];
    let names = ["weights", "exp_avg", "exp_avg_sq", "moving average"];
    let expected = host.iter().chain([&average]);
    for ((what, found), expected) in names.into_iter().zip(found).zip(expected) {
        let difference = error(&found.try_into_vec_as::<f32>().expect("float32"), expected);
        assert!(difference < 1e-6, "{name}: {what} differ by {difference:e}");
        println!("{name}: after {steps} steps {what} differ by {difference:.1e}");
    }
}
