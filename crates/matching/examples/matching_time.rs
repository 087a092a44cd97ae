//! Time to make a motion of twice a BVH file's length with the settings of the published program.
//!
//! ```sh
//! cargo run --release -p kinegrad-matching --example matching_time -- --rounds 9 dance.bvh
//! ```
//!
//! prints the least and the median seconds of the synthesis alone, from matrix to matrix, and of a
//! job, which converts the file to a matrix and back.

use std::time::Instant;

use kinegrad_matching::{Job, Request, synthesize};

mod common;

use common::read;

fn main() {
    let (mut rounds, mut files) = (9, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--rounds" => {
                let number = arguments.next().and_then(|n| n.parse().ok());
                rounds = number.expect("a number");
            }
            file => files.push(read(file)),
        }
    }
    for example in files {
        let (mut alone, mut jobs) = (Vec::new(), Vec::new());
        for seed in 0..rounds {
            let job = Job {
                seed,
                ..Job::default()
            };
            let start = Instant::now();
            let made = job.make(std::slice::from_ref(&example)).expect("a motion");
            jobs.push(start.elapsed().as_secs_f64());
            let request = Request {
                examples: &made.examples,
                frames: 2 * made.examples[0].frames(),
                settings: &job.settings,
                groups: &[],
                constraints: &[],
            };
            let start = Instant::now();
            let new = synthesize(&request, seed).expect("a motion");
            alone.push(start.elapsed().as_secs_f64());
            assert_eq!(new.frames, made.synthesis.frames);
        }
        let [least, median] = spread(alone);
        let [job_least, job_median] = spread(jobs);
        println!(
            "{}: synthesis {least:.4} {median:.4}, job {job_least:.4} {job_median:.4}",
            example.file
        );
    }
}

/// The least and the median.
fn spread(mut seconds: Vec<f64>) -> [f64; 2] {
    seconds.sort_by(f64::total_cmp);
    [seconds[0], seconds[seconds.len() / 2]]
}
