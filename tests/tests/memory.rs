//! Sampling keeps no graph alive.

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use kinegrad_diffusion::{ClipRange, DiffusionConfig, GaussianDiffusion, SamplerConfig, sample};
use kinegrad_models::Initializer;
use kinegrad_random::{Key, Purpose};
use kinegrad_tests::parity::tiny;
use kinegrad_train::device;

/// Resident memory of this process, in bytes.
fn resident() -> Option<u64> {
    let pages = std::fs::read_to_string("/proc/self/statm").ok()?;
    pages
        .split_whitespace()
        .nth(1)?
        .parse::<u64>()
        .ok()
        .map(|pages| pages * 4096)
}

#[test]
fn memory_stays_flat_over_200_sampler_calls() {
    let (cpu, _) = device::open("cpu").expect("the CPU");
    // The weights of a network in training, as validation and sampling take them.
    let trained = tiny()
        .init(25, 163, &Initializer::new(0, &cpu.clone().autodiff()))
        .expect("a network");
    let model = trained.valid();
    let diffusion = GaussianDiffusion::new(&DiffusionConfig::default()).expect("a process");
    let sampler = SamplerConfig {
        num_inference_steps: 2,
        ..SamplerConfig::default()
    };
    let key = Key::new(0, Purpose::Sampling);
    let draw = |index: u64| {
        let tensor = |channels: usize| -> Tensor<3> {
            let values = key.at(index).normals(channels * 16);
            Tensor::from_data(TensorData::new(values, [1, channels, 16]), &cpu)
        };
        let drawn = sample(
            &diffusion,
            &model,
            tensor(25),
            &tensor(163).into(),
            &sampler,
            &ClipRange::None,
            key.at(index),
            &mut |_, _, _| std::ops::ControlFlow::Continue(()),
        );
        drawn.expect("a sample")
    };
    (0..20).for_each(|index| drop(draw(index)));
    let Some(before) = resident() else { return };
    (20..220).for_each(|index| drop(draw(index)));
    let grown = resident().expect("as before").saturating_sub(before);
    assert!(
        grown < 8 << 20,
        "resident memory grew by {} KiB",
        grown >> 10
    );
}
