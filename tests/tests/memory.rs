//! Sampling keeps no graph in memory.

use std::sync::{Mutex, PoisonError};

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use kinegrad_diffusion::{ClipRange, DiffusionConfig, GaussianDiffusion, SamplerConfig, sample};
use kinegrad_diffusion::{FlowPrediction, SamplerKind};
use kinegrad_flow::network::FlowConfig;
use kinegrad_flow::network::{FlowRollout, FlowSpace, RolloutSettings};
use kinegrad_models::Initializer;
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_motion::humanml::{Joints, NextPose, Skeleton};
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

/// A lock of the running test: each test measures the memory of the whole process.
static ALONE: Mutex<()> = Mutex::new(());

#[test]
fn memory_stays_flat_over_200_sampler_calls() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (cpu, _) = device::open("cpu").expect("the CPU");
    // The weights of a network in training, as used by validation and sampling.
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

#[test]
fn memory_stays_flat_over_10_000_frames_of_a_rollout() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (cpu, _) = device::open("cpu").expect("the CPU");
    let skeleton = Skeleton::humanml3d();
    let course = Course {
        speed: Box::new(|_| 1.0),
        turning: Box::new(|_| 0.0),
    };
    let history = walk::joints(&course, &skeleton, 4);
    let history = Joints::new(history, skeleton.joints()).expect("finite joints");
    let init = Initializer::new(0, &cpu.clone().autodiff());
    let trained = FlowConfig::tiny().init(&skeleton, &init).expect("networks");
    let space = FlowSpace {
        features: Statistics::unit(skeleton.layout().channels()),
        target: Statistics::new(vec![0.0; 66], vec![1e-3; 66], None).expect("valid"),
        next: NextPose::Displacement,
        prediction: FlowPrediction::Velocity,
        history: 3,
        longest: 196,
        skeleton,
    };
    let settings = RolloutSettings {
        sampler: SamplerConfig {
            guidance_scale: 2.0,
            ..SamplerConfig::new(SamplerKind::Euler, 1)
        },
        frames: 11_000,
        constant_bones: true,
        same_noise: false,
        contact_threshold: 0.002,
    };
    let key = Key::new(0, Purpose::Sampling);
    let rollout = FlowRollout::new(trained.valid(), space, settings, &history, key, &cpu);
    let mut rollout = rollout.expect("a history");
    let mut draw = |frames: usize| {
        for _ in 0..frames {
            let frame = rollout.next_frame().expect("finite");
            assert!(frame.is_some());
        }
    };
    draw(1_000);
    let Some(before) = resident() else { return };
    draw(10_000);
    let grown = resident().expect("as before").saturating_sub(before);
    assert!(
        grown < 8 << 20,
        "resident memory grew by {} KiB",
        grown >> 10
    );
}
