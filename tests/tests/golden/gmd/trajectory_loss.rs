//! The trajectory loss with weighted first channels.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{LossType, PredictionType};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_train::clips::{ChannelWeights, weighted_masked_loss};

use super::bench::process;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![golden_gmd_trajectory_loss(
        "gmd/trajectory_loss.safetensors"
    ),]
}

fn golden_gmd_trajectory_loss(golden: Golden) {
    let device = Device::flex().autodiff();
    let w = golden.tensor::<2>("model.W", &device).require_grad();
    let v = golden.tensor::<1>("model.v", &device).require_grad();
    let s = golden.get("model.s").scalar();
    let timesteps = golden.get("in.t").indices();
    let input = |name: &str| golden.get(name).flat().tensor::<3>(&device);
    let (x_start, noise) = (input("in.x0"), input("in.noise"));
    let [batch, channels, frames] = x_start.dims();
    let mask = golden.get("in.mask").tensor::<4>(&device);
    let mask = mask.reshape([batch, frames]);
    for (kind, prediction_type) in [
        ("x0", PredictionType::Sample),
        ("eps", PredictionType::Epsilon),
    ] {
        let diffusion = process(prediction_type);
        for k in golden.get("in.k").values {
            let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
            golden.get(&format!("out.{kind}.x_t")).flat().assert_within(
                "x_t",
                x_t.clone(),
                1e-5,
                0.0,
            );
            let times: Vec<f32> = timesteps.iter().map(|&t| t as f32 / 1000.0).collect();
            let times = burn::tensor::TensorData::new(times, [batch, 1, 1]);
            let times: Tensor<3> = Tensor::from_data(times, &device);
            let told = v.clone().unsqueeze::<2>().unsqueeze_dim::<3>(2) * times;
            let output = (w.clone().unsqueeze::<3>().matmul(x_t) + told).tanh() * s;
            golden
                .get(&format!("out.{kind}.pred"))
                .flat()
                .assert_within("prediction", output.clone(), 1e-5, 0.0);
            let target = diffusion.target(x_start.clone(), noise.clone(), &timesteps);
            let mut weights = vec![1.0; channels];
            weights[..4].fill(k * k);
            let weights = ChannelWeights::mean(&weights);
            // The loss of each sample, then the batch's mean.
            let name = format!("{kind}.k{k}");
            for sample in 0..batch {
                let of = |x: &Tensor<3>| x.clone().narrow(0, sample, 1);
                let masked = mask.clone().narrow(0, sample, 1);
                let loss = weighted_masked_loss(
                    of(&output),
                    of(&target),
                    masked,
                    &weights,
                    0.0,
                    None,
                    LossType::Mse,
                );
                let expected = golden.get(&format!("out.{name}.loss")).values[sample];
                let found = f64::from(loss.into_scalar::<f32>());
                golden.bound(&name, (found / expected - 1.0).abs(), 1e-5);
            }
            literal(&golden, &name, &output, &target, k);
            let loss = weighted_masked_loss(
                output,
                target,
                mask.clone(),
                &weights,
                0.0,
                None,
                LossType::Mse,
            );
            let gradients = loss.backward();
            golden.get(&format!("grad.{name}.W")).assert_close_tensor(
                "dW",
                w.grad(&gradients).expect("one"),
                1e-4,
            );
            golden.get(&format!("grad.{name}.v")).assert_close_tensor(
                "dv",
                v.grad(&gradients).expect("one"),
                1e-4,
            );
        }
    }
}

/// Equation 5 as the appendix prints it: for each frame, padded or not, the sum over channels with
/// the factor at three of them.
fn literal(golden: &Golden, name: &str, output: &Tensor<3>, target: &Tensor<3>, k: f64) {
    let [batch, channels, frames] = output.dims();
    let mut weights = vec![1.0; channels];
    weights[..3].fill(k * k);
    let weights = ChannelWeights::sum(&weights);
    let of = |x: &Tensor<3>, sample: usize, frame: usize| {
        x.clone().narrow(0, sample, 1).narrow(2, frame, 1)
    };
    let mut found = Vec::new();
    for sample in 0..batch {
        for frame in 0..frames {
            let (output, target) = (of(output, sample, frame), of(target, sample, frame));
            let mask = Tensor::ones([1, 1], &output.device());
            let loss =
                weighted_masked_loss(output, target, mask, &weights, 0.0, None, LossType::Mse);
            found.push(f64::from(loss.into_scalar::<f32>()));
        }
    }
    golden.compare_relative(&format!("out.{name}.eq5_per_frame"), &found, 1e-5);
}
