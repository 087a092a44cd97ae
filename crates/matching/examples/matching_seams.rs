//! Smoothness of new motions at the seam of a loop and around key frames, relative to the rest of
//! the motion.
//!
//! ```sh
//! cargo run --release -p kinegrad-matching --example matching_seams -- --seeds 3 dance.bvh
//! ```
//!
//! prints for each file and seed:
//! - the step and the change of velocity at a loop's seam, relative to the 95th percentile of the
//!   rest;
//! - for key frames at a quarter, a half and three quarters of the file: the mean jerk in the
//!   second around the key frame relative to the jerk elsewhere, the same ratio in the file, and
//!   the jerk relative to the file's.

use kinegrad_capture::Bvh;
use kinegrad_matching::{Example, Job, Keyframe, Length, Looping, Made, Seam, jerk_around, jerks};

mod common;

use common::read;

fn main() {
    let (mut seeds, mut files) = (3, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().expect("a value");
        match argument.as_str() {
            "--seeds" => seeds = value().parse().expect("a number"),
            file => files.push(file.to_string()),
        }
    }
    for file in &files {
        let example = [read(file)];
        for seed in 0..seeds {
            let mut job = job(seed);
            job.settings.looping = Looping::Even;
            let Seam { step, velocity } = seam(&job, &example);
            println!("{file} seed {seed}: loop step {step:.2}, velocity {velocity:.2}");
            for part in [0.25, 0.5, 0.75] {
                let seconds = example[0].bvh.frames() as f64 * example[0].bvh.frame_time();
                job.keyframes = vec![(keyframe(part * seconds), None)];
                let Seam { step, velocity } = seam(&job, &example);
                println!(
                    "{file} seed {seed}: loop with a key frame of {part}, step {step:.2}, \
                     velocity {velocity:.2}"
                );
            }
        }
        let seconds = example[0].bvh.frames() as f64 * example[0].bvh.frame_time();
        for part in [0.25, 0.5, 0.75] {
            for seed in 0..seeds {
                let mut job = job(seed);
                job.keyframes = vec![(keyframe(part * seconds), None)];
                let made = job.make(&example).expect("a motion");
                let rate = 1.0 / made.layout.frame_time();
                let [near, rest] = jerk_around(&jerks(&made.bvh), 5.0 * rate, rate);
                let source = jerks(&thinned(&example[0], &made));
                let [own, own_rest] = jerk_around(&source, part * seconds * rate, rate);
                println!(
                    "{file} seed {seed}: key frame of {part}, jerk {:.2}, source {:.2}, of it {:.2}",
                    near / rest,
                    own / own_rest,
                    near / own
                );
            }
        }
    }
}

fn job(seed: u64) -> Job {
    Job {
        length: Some(Length::Seconds(10.0)),
        seed,
        ..Job::default()
    }
}

fn seam(job: &Job, example: &[Example]) -> Seam {
    let made = job.make(example).expect("a loop");
    made.seam(job.settings.looping).expect("a loop")
}

fn keyframe(source_time: f64) -> Keyframe {
    Keyframe {
        time: 5.0,
        source_time,
        file: None,
        part: None,
        place: None,
        reach: None,
        name: String::new(),
    }
}

/// An example at the frame rate of the motion that was made of it.
fn thinned(example: &Example, made: &Made) -> Bvh {
    let frames = made.layout.to_frames(example).expect("an example");
    made.layout.to_bvh(&frames).expect("an example")
}
