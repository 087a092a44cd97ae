//! Second-order samplers against diffusers (scripts/peer/samplers.py).

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    BetaSchedule, ClipRange, Denoiser, DiffusionConfig, GaussianDiffusion, PredictionType,
    SamplerConfig, SamplerKind, Time, Timesteps, sample,
};
use kinegrad_random::{Key, Purpose};
use kinegrad_tests::golden::{Golden, GoldenTensors, workspace};

/// `1.5 tanh(W x + v t / 1000)` of every frame.
struct Toy {
    w: Tensor<3>,
    v: Tensor<3>,
}

impl Denoiser for Toy {
    type Cond = ();

    fn predict(&self, x_t: Tensor<3>, time: &[Time], _: &()) -> Tensor<3> {
        (self.w.clone().matmul(x_t) + self.v.clone() * (time[0].0 / 1000.0)).tanh() * 1.5
    }

    fn null_cond(&self, _: &()) {}
}

#[test]
fn every_state_is_that_of_diffusers() {
    let file = Golden::read(&workspace().join("data_fixtures/samplers/diffusers.safetensors"));
    let device = Device::flex();
    let toy = Toy {
        w: file.tensor::<2>("W", &device).unsqueeze(),
        v: file.tensor::<1>("v", &device).reshape([1, 3, 1]),
    };
    let mut compared = 0;
    for (kind, prefix) in [
        (SamplerKind::Dpmpp2m(Timesteps::default()), "dpmpp_2m"),
        (SamplerKind::Heun(Timesteps::default()), "heun"),
    ] {
        for (prediction_type, name) in [
            (PredictionType::Epsilon, "epsilon"),
            (PredictionType::Sample, "sample"),
            (PredictionType::VPrediction, "v_prediction"),
        ] {
            let diffusion = GaussianDiffusion::new(&DiffusionConfig {
                beta_schedule: BetaSchedule::Linear,
                prediction_type,
                ..DiffusionConfig::default()
            })
            .expect("a process");
            for (count, steps) in [("few", 5), ("many", 20)] {
                let name = format!("{prefix}.{name}.{count}");
                if !file.has(&name) {
                    // diffusers' Heun does not support sample prediction.
                    assert!(prefix == "heun" && prediction_type == PredictionType::Sample);
                    continue;
                }
                let expected = file.get(&name).f32s();
                let mut found: Vec<f32> = Vec::new();
                let config = SamplerConfig::new(kind, steps);
                sample(
                    &diffusion,
                    &toy,
                    file.tensor("x_T", &device),
                    &(),
                    &config,
                    &ClipRange::None,
                    Key::new(0, Purpose::Sampling),
                    &mut |_, _, x| {
                        let state = x.to_data().try_to_vec::<f32>();
                        found.extend(state.expect("float32"));
                        std::ops::ControlFlow::Continue(())
                    },
                )
                .expect("a sample");
                assert_eq!(found.len(), expected.len(), "{name}");
                let largest = expected.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                let pairs = found.iter().zip(&expected);
                let error = pairs.fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
                assert!(error < 2e-5 * largest, "{name}: {error} of {largest}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 10);
}
