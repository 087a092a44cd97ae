//! Memory of a training pass of the phrase network, with and without activation checkpointing.
//!
//! ```text
//! cargo run --release -p kinegrad-cc-motion --example activation_memory
//! ```

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_cc_motion::network::unet1d::{AudioConditioning, UNet1dConfig};
use kinegrad_diffusion::Time;
use kinegrad_models::Initializer;
use kinegrad_random::{Key, Purpose};

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: the system's allocator does the work.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(live, Ordering::Relaxed);
        // SAFETY: the caller's contract is that of the system's allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const BATCH: usize = 32;
const FRAMES: usize = 120;

fn main() {
    for conditioning in [AudioConditioning::Aligned, AudioConditioning::Ccmotion] {
        for checkpoints in [false, true] {
            let device = Device::flex().autodiff();
            let device = match checkpoints {
                true => device.gradient_checkpointing(),
                false => device,
            };
            measure(conditioning, checkpoints, &device);
        }
    }
}

fn measure(audio_conditioning: AudioConditioning, checkpoints: bool, device: &Device) {
    let config = UNet1dConfig {
        audio_conditioning,
        ..UNet1dConfig::small()
    };
    let network = config.init(25, 163, &Initializer::new(3, device));
    let network = network.expect("a valid network");
    let normal = |stream: u64, channels: usize| {
        let values = Key::new(8, Purpose::Noise).at(stream);
        let values = values.normals(BATCH * channels * FRAMES);
        Tensor::<3>::from_data(TensorData::new(values, [BATCH, channels, FRAMES]), device)
    };
    let (x, audio) = (normal(0, 25), normal(1, 163));
    let times: Vec<usize> = (0..BATCH).map(|sample| 10 * sample).collect();
    let pass = || network.forward(x.clone(), &Time::of(&times), audio.clone(), None);
    // Parameters are initialised at first use.
    let _ = pass().inner();
    let before = LIVE.load(Ordering::Relaxed);
    let above = |counter: &AtomicUsize| (counter.load(Ordering::Relaxed) - before) >> 20;
    PEAK.store(before, Ordering::Relaxed);
    let start = Instant::now();
    let y = pass();
    let (stored, forward) = (above(&LIVE), above(&PEAK));
    let gradients = y.square().mean().backward();
    let (seconds, peak) = (start.elapsed().as_secs_f64(), above(&PEAK));
    drop(gradients);
    println!(
        "{audio_conditioning:?}, checkpointing {checkpoints}: {stored} MiB stored, peaks of the \
         passes {forward} and {peak} MiB, {seconds:.2} s"
    );
}
