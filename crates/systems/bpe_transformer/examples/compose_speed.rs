//! Time and memory of one guided prediction of a long composed motion at the published size, with
//! random weights. `scripts/peer/flowmdm/compare.py` runs this example beside PyTorch.
//!
//! ```sh
//! cargo run --release -p kinegrad-bpe-transformer --example compose_speed -- FRAMES STEPS
//! ```
//!
//! The example prints the median seconds of a step, and the memory added by steps in MiB. For
//! memory measurements, set `RETURN_FREED` and `MALLOC_MMAP_THRESHOLD_=65536`: freed memory then
//! returns to the system. Otherwise steps reuse memory from the sampling of weights.

use std::time::Instant;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{BlendedConfig, Composed, Segment, Switch, TextSegments};
use kinegrad_diffusion::{Denoiser, Time, guided};
use kinegrad_models::Initializer;
use kinegrad_random::{Key, Purpose};

/// Frames per text.
const SEGMENT: usize = 100;

fn main() {
    let mut arguments = std::env::args()
        .skip(1)
        .map(|text| text.parse().expect("a number"));
    let frames: usize = arguments.next().unwrap_or(2000);
    let steps: usize = arguments.next().unwrap_or(10);
    if std::env::var_os("RETURN_FREED").is_none() {
        kinegrad_kernels::memory::keep_freed();
    }
    let device = Device::flex();
    let init = Initializer::new(0, &device);
    let network = BlendedConfig::flowmdm()
        .init(263, 512, &init)
        .expect("valid");
    // Initializes the lazy weights.
    let network = network.valid();
    let _ = kinegrad_models::parameters::values(&network).len();
    let texts = frames.div_ceil(SEGMENT);
    let segments = (0..texts).map(|text| Segment {
        text,
        frames: SEGMENT.min(frames - text * SEGMENT),
    });
    let composed = Composed {
        network: &network,
        path: None,
        path_guidance_scale: 1.0,
        segments: TextSegments::new([segments.collect()]),
        switch: Switch {
            bpe_denoising_step: 60,
            num_train_timesteps: 1000,
        },
    };
    let random = |name: &str, shape: [usize; 3]| {
        let values = Key::new(1, Purpose::Noise)
            .named(name)
            .normals(shape.iter().product());
        Tensor::<3>::from_data(TensorData::new(values, shape), &device)
    };
    let (x, cond) = (
        random("x", [1, 263, frames]),
        random("text", [texts, 512, 1]),
    );
    // Initializes the lazy weights.
    let short = Composed {
        network: &network,
        path: None,
        path_guidance_scale: 1.0,
        segments: TextSegments::single([4]),
        switch: composed.switch,
    };
    let _ = short.predict(
        random("short", [1, 263, 4]),
        &[Time(0.0)],
        &random("one", [1, 512, 1]),
    );
    // Resets the peak of resident memory.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
    let before = resident("VmRSS");
    // Half of the steps are absolute.
    let step = |number: usize| {
        let begin = Instant::now();
        let t = if number.is_multiple_of(2) {
            990.0
        } else {
            500.0
        };
        let y = guided(&composed, x.clone(), &[Time(t)], &cond, 2.5);
        let sum = y.sum().into_scalar::<f32>();
        assert!(sum.is_finite());
        begin.elapsed().as_secs_f64()
    };
    step(0);
    let mut seconds: Vec<f64> = (0..steps).map(step).collect();
    if std::env::var_os("EACH_STEP").is_some() {
        eprintln!("absolute and relative steps in turn: {seconds:.3?}");
    }
    seconds.sort_by(f64::total_cmp);
    println!(
        "{:.4} {:.1}",
        seconds[steps / 2],
        resident("VmHWM") - before
    );
}

/// A memory value of the process's status, MiB.
fn resident(name: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status
        .lines()
        .find(|line| line.starts_with(name))
        .expect("a line");
    let kib: f64 = line
        .split_whitespace()
        .nth(1)
        .expect("a number")
        .parse()
        .expect("KiB");
    kib / 1024.0
}
