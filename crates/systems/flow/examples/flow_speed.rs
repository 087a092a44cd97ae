//! Speed of the flow networks at the published size, with random weights.
//!
//! ```sh
//! RAYON_NUM_THREADS=1 cargo run --release -p kinegrad-flow --example flow_speed
//! ```
//!
//! The example prints a rollout's frames per second by solver and number of steps. It also prints
//! the milliseconds of one forward and backward pass of both networks over 64 windows of 15 rows,
//! with the kernels and with composed operations. With a number of Euler steps as argument, the
//! example prints only the rollout with these steps.

use std::time::Instant;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{
    Dopri5, FlowPrediction, LossType, SamplerConfig, SamplerKind, Timesteps, diffusion_loss,
};
use kinegrad_flow::network::{
    FlowCondition, FlowConfig, FlowRollout, FlowSpace, History, RolloutSettings, previous_state,
};
use kinegrad_kernels::Mode;
use kinegrad_models::Initializer;
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_motion::humanml::{Joints, NextPose, Skeleton};
use kinegrad_random::{Key, Purpose};

/// Rows of a history.
const HISTORY: usize = 15;

fn main() {
    if let Some(steps) = std::env::args().nth(1) {
        let steps = steps.parse().expect("a number of steps");
        let speed = rollout(SamplerKind::Euler, steps, 1.0);
        return println!("euler {steps}: {speed:.1}");
    }
    println!("rollout, frames a second:");
    for (kind, steps) in [
        (SamplerKind::Euler, 1),
        (SamplerKind::Euler, 5),
        (SamplerKind::Euler, 10),
        (SamplerKind::Midpoint, 5),
        (SamplerKind::Heun(Timesteps::default()), 5),
        (SamplerKind::Dopri5(Dopri5::default()), 2),
    ] {
        for guidance_scale in [1.0, 2.5] {
            let speed = rollout(kind, steps, guidance_scale);
            println!("  {kind} {steps}, guidance {guidance_scale}: {speed:.1}");
        }
    }
    println!("forward and backward pass, milliseconds:");
    for mode in [Mode::Fused, Mode::Composed] {
        println!("  {mode:?}: {:.1}", mode.scope(step));
    }
}

/// Frames per second of a rollout.
fn rollout(kind: SamplerKind, num_inference_steps: usize, guidance_scale: f64) -> f64 {
    let (device, skeleton) = (Device::flex(), Skeleton::humanml3d());
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|_| 0.2),
    };
    let history = walk::joints(&course, &skeleton, HISTORY + 1);
    let history = Joints::new(history, skeleton.joints()).expect("finite joints");
    let init = Initializer::new(0, &device);
    let model = FlowConfig::published()
        .init(&skeleton, &init)
        .expect("valid");
    // Keeps poses nearly constant, because the weights are untrained.
    let target = Statistics::new(vec![0.0; 66], vec![1e-3; 66], None).expect("valid");
    let space = FlowSpace {
        features: Statistics::unit(skeleton.layout().channels()),
        target,
        next: NextPose::Displacement,
        prediction: FlowPrediction::Velocity,
        history: HISTORY,
        longest: 196,
        skeleton,
    };
    let frames = 60;
    let settings = RolloutSettings {
        sampler: SamplerConfig {
            guidance_scale,
            ..SamplerConfig::new(kind, num_inference_steps)
        },
        frames: 2 * frames,
        constant_bones: true,
        same_noise: false,
        contact_threshold: 0.002,
    };
    let key = Key::new(0, Purpose::Sampling);
    let rollout = FlowRollout::new(model, space, settings, &history, key, &device);
    let mut rollout = rollout.expect("a history");
    let mut sample = || {
        for _ in 0..frames {
            rollout.next_frame().expect("a finite frame");
        }
    };
    sample();
    let begin = Instant::now();
    sample();
    frames as f64 / begin.elapsed().as_secs_f64()
}

/// Milliseconds of a pass, the median of nine.
fn step() -> f64 {
    const BATCH: usize = 64;
    let (device, skeleton) = (Device::flex().autodiff(), Skeleton::humanml3d());
    let init = Initializer::new(0, &device);
    let model = FlowConfig::published()
        .init(&skeleton, &init)
        .expect("valid");
    let key = Key::new(1, Purpose::Noise);
    let random = |name: &str, shape: [usize; 3]| {
        let values = key.named(name).normals(shape.iter().product());
        Tensor::<3>::from_data(TensorData::new(values, shape), &device)
    };
    let frames = random("frames", [BATCH, 263, HISTORY]);
    let (noise, x_start) = (
        random("noise", [BATCH, 3, 22]),
        random("data", [BATCH, 3, 22]),
    );
    let t: Vec<f64> = (0..BATCH)
        .map(|i| (i as f64 + 0.5) / BATCH as f64)
        .collect();
    let times = TensorData::new(t.iter().map(|&t| t as f32).collect(), [BATCH]);
    let times = Tensor::<1>::from_data(times, &device);
    let pass = || {
        let begin = Instant::now();
        let context = model.encoder.forward(History {
            frames: frames.clone(),
            lengths: vec![HISTORY; BATCH],
            text: random("text", [BATCH, 512, 1]).squeeze_dim(2),
            duration: None,
        });
        let last = frames.clone().narrow(2, HISTORY - 1, 1).squeeze_dim(2);
        let cond = FlowCondition {
            context,
            null_context: None,
            previous: previous_state(last),
            progress: times.clone(),
        };
        let x_t = FlowPrediction::add_noise(noise.clone(), x_start.clone(), &t);
        let v = model.predictor.forward(x_t, times.clone(), &cond);
        let target = FlowPrediction::Velocity.target(noise.clone(), x_start.clone());
        let loss = diffusion_loss(v, target, None, None, LossType::Mse);
        kinegrad_models::gradients(&model, &mut loss.backward());
        begin.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..9).map(|_| pass()).collect();
    times.sort_by(f64::total_cmp);
    times[4]
}
