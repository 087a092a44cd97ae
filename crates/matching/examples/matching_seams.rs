//! Smoothness of new motions of BVH files where something is joined: over the seam of a loop and
//! around key frames, beside the rest of the motion.
//!
//! ```sh
//! cargo run --release -p kinegrad-matching --example matching_seams -- --seeds 3 dance.bvh
//! ```
//!
//! prints for each file and seed of the loop the seam's step and its change of velocity as parts of
//! the 95th percentile of all others, and for key frames at a quarter, a half and three quarters of
//! the file the mean jerk of the second around as a part of the jerk elsewhere, the same of that
//! second of the file, and the jerk as a part of that second's.

use kinegrad_capture::Bvh;
use kinegrad_matching::{
    Example, Job, Keyframe, Length, Looping, Made, jerk_around, jerks, percentile_95,
};

mod common;

use common::read;

/// Places of the joints, `[frames][joints]`.
type Places = Vec<Vec<[f64; 3]>>;

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
            let motion = places(&job.make(&example).expect("a loop").bvh);
            let [step, turn] = seam(&motion);
            println!("{file} seed {seed}: loop step {step:.2}, velocity {turn:.2}");
        }
        let seconds = example[0].bvh.frames() as f64 * example[0].bvh.frame_time();
        for part in [0.25, 0.5, 0.75] {
            for seed in 0..seeds {
                let mut job = job(seed);
                job.keyframes = vec![(keyframe(part * seconds), None)];
                let made = job.make(&example).expect("a motion");
                let rate = 1.0 / made.figure.frame_time();
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

fn keyframe(source_time: f64) -> Keyframe {
    Keyframe {
        time: 5.0,
        source_time,
        file: None,
        part: None,
        place: None,
        reach: None,
    }
}

/// Where the joints are, seen from above the body.
fn places(bvh: &Bvh) -> Places {
    let frames = (0..bvh.frames()).map(|t| {
        let world = bvh.world(t);
        let [x, _, z] = world[1].position;
        let seen = world.iter().map(|pose| pose.position);
        seen.map(|[a, b, c]| [a - x, b, c - z]).collect()
    });
    frames.collect()
}

/// An example with as many frames a second as what was made of it.
fn thinned(example: &Example, made: &Made) -> Bvh {
    let frames = made.figure.frames(example).expect("an example");
    made.figure.bvh(&frames).expect("an example")
}

/// Mean distance of the joints' weighted sums of frames from the origin.
fn mean(motion: &Places, terms: &[(usize, f64)]) -> f64 {
    let joints = motion[0].len();
    let of = |joint: usize| {
        let sum = [0, 1, 2].map(|axis| {
            let terms = terms.iter();
            terms
                .map(|(t, weight)| weight * motion[*t][joint][axis])
                .sum::<f64>()
        });
        sum.iter().map(|value| value * value).sum::<f64>().sqrt()
    };
    (0..joints).map(of).sum::<f64>() / joints as f64
}

/// The seam's step and change of velocity, as parts of the 95th percentile of all others.
fn seam(motion: &Places) -> [f64; 2] {
    let n = motion.len();
    let step = |t: usize| mean(motion, &[((t + 1) % n, 1.0), (t, -1.0)]);
    let turn = |t: usize| mean(motion, &[((t + 2) % n, 1.0), ((t + 1) % n, -2.0), (t, 1.0)]);
    let steps: Vec<f64> = (0..n - 1).map(step).collect();
    let turns: Vec<f64> = (0..n - 2).map(turn).collect();
    let over = turn(n - 2).max(turn(n - 1));
    [
        step(n - 1) / percentile_95(&steps),
        over / percentile_95(&turns),
    ]
}
