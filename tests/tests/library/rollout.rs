//! Rollouts of a network of a few million parameters: the memory modes have the same gradients.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_cc_motion::network::AudioCondition;
use kinegrad_cc_motion::network::AudioConditioning;
use kinegrad_cc_motion::network::UNet1d;
use kinegrad_cc_motion::network::UNet1dConfig;
use kinegrad_diffusion::{
    ClipRange, DiffusionConfig, GaussianDiffusion, PredictionType, Rollout, RolloutMode, Time,
    rollout_timesteps,
};
use kinegrad_kernels::Lengths;
use kinegrad_models::GradientSum;
use kinegrad_models::Initializer;
use kinegrad_random::{Key, Purpose};

/// Network H of the golden files, 3,704,569 parameters; or one of its size with aligned audio
/// conditioning.
fn network(audio_conditioning: AudioConditioning, device: &Device) -> UNet1d {
    let config = UNet1dConfig {
        model_channels: 32,
        time_embed_dim: 64,
        context_dim: match audio_conditioning {
            AudioConditioning::Ccmotion => 48,
            AudioConditioning::Aligned => 64,
        },
        audio_conditioning,
        ..UNet1dConfig::default()
    };
    config
        .init(25, 163, &Initializer::new(7, device))
        .expect("a valid network")
}

fn normal(index: u64, shape: [usize; 3]) -> Tensor<3> {
    let values = Key::new(1, Purpose::Noise)
        .at(index)
        .normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn gradients(
    audio: AudioConditioning,
    steps: usize,
    guidance_scale: f64,
    mode: RolloutMode,
) -> Vec<Vec<f32>> {
    let model = network(audio, &Device::flex().autodiff());
    let config = DiffusionConfig {
        prediction_type: PredictionType::Sample,
        ..DiffusionConfig::default()
    };
    let rollout = Rollout {
        diffusion: GaussianDiffusion::new(&config).expect("a valid process"),
        clip: ClipRange::StraightThrough(Box::new(ClipRange::Symmetric(3.0))),
        guidance: guidance_scale.into(),
        gradient_decay: 1.0,
    };
    let start = normal(0, [2, 25, 16]);
    let cond = AudioCondition {
        lengths: Some(Lengths::new([11, 16])),
        ..normal(1, [2, 163, 16]).into()
    };
    let timesteps = rollout_timesteps(&[999, 500], steps);
    let output = rollout
        .run(&model, &model.valid(), start, &cond, &timesteps, mode)
        .expect("it fits");
    let mut sum = GradientSum::default();
    let mut tracked = output.x.square().sum().backward();
    if let Some(trace) = output.trace {
        trace
            .backward(
                &rollout,
                &model,
                &cond,
                &mut tracked,
                &mut |_, mut local| {
                    sum.add(&model, &mut local);
                },
            )
            .expect("it fits");
    }
    sum.add(&model, &mut tracked);
    sum.into_host(&model)
}

#[test]
fn checkpointed_gradients_are_those_of_one_graph() {
    use AudioConditioning::{Aligned, Ccmotion};
    for (audio, steps, guidance_scale) in [
        (Ccmotion, 5, 1.0),
        (Ccmotion, 20, 1.0),
        (Ccmotion, 5, 2.0),
        (Aligned, 5, 2.0),
    ] {
        let of_mode = |mode| gradients(audio, steps, guidance_scale, mode);
        let full = of_mode(RolloutMode::Full);
        let checkpointed = of_mode(RolloutMode::Checkpointed);
        let largest = full.iter().flatten().fold(0.0f32, |m, g| m.max(g.abs()));
        let mut worst = 0.0f32;
        for (full, checkpointed) in full.iter().zip(&checkpointed) {
            for (a, b) in full.iter().zip(checkpointed) {
                worst = worst.max((a - b).abs() / largest);
            }
        }
        assert!(largest > 0.0 && worst < 1e-6, "K = {steps}: {worst:e}");
        println!(
            "{audio:?}, K = {steps}, guidance {guidance_scale}: largest difference {worst:.1e}"
        );
    }
}

#[test]
fn the_network_computes_the_same_bits_with_and_without_gradients() {
    use AudioConditioning::{Aligned, Ccmotion};
    for audio in [Ccmotion, Aligned] {
        let model = network(audio, &Device::flex().autodiff());
        let (x, cond) = (normal(0, [2, 25, 16]), normal(1, [2, 163, 16]));
        let bits = |x: Tensor<3>| {
            let values = x
                .without_autodiff()
                .try_into_vec_as::<f32>()
                .expect("float32");
            values.iter().map(|v| v.to_bits()).collect::<Vec<u32>>()
        };
        let with = model.forward(x.clone(), &Time::of(&[3, 900]), cond.clone(), None);
        let without = model.valid().forward(x, &Time::of(&[3, 900]), cond, None);
        assert!(bits(with) == bits(without), "{audio:?}");
    }
}
