//! Measures of bodies combined from two motions, and of a motion in the style of another.
//!
//! ```sh
//! cargo run --release -p kinegrad-matching --example matching_uses -- --seeds 5 dance.bvh walk.bvh
//! ```
//!
//! makes two kinds of motion: the legs of the second file under the body of the first, and the
//! second file in the style of the first. The table contains the mean distance of the new motion's
//! windows of 15 frames to the nearest window of either file, over the joints of the legs and over
//! all others. Further rows are the second file itself, and new motions of the first alone. "In
//! time" is the correlation of the legs' rotations with the second file at the same moments. Jerk
//! is the 95th percentile, relative to the file with more jerk.

use kinegrad_capture::Bvh;
use kinegrad_matching::{
    CoarseRatio, Example, Fixed, Frames, Job, Length, Made, Measures, Part, jerks, percentile_95,
};

mod common;

use common::read;

fn main() {
    let (mut seeds, mut files) = (5, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--seeds" => {
                let number = arguments.next().and_then(|n| n.parse().ok());
                seeds = number.expect("a number");
            }
            file => files.push(read(file)),
        }
    }
    let [first, second] = files.try_into().expect("two files");
    let legs = Fixed {
        part: "legs".to_string(),
        motion: second.clone(),
    };
    let style = |k: f64| {
        let mut job = Job {
            content: Some(second.clone()),
            ..Job::default()
        };
        job.settings.coarse_ratio = CoarseRatio::Patches(k);
        job
    };
    println!("windows to: first others, second others, first legs, second legs; in time; jerk");
    let same = |job: Job| vec![job];
    let of_seeds = |job: Job| -> Vec<Job> {
        let seeded = |seed| Job {
            seed,
            ..job.clone()
        };
        (0..seeds).map(seeded).collect()
    };
    let fixed = Job {
        fixed: vec![legs],
        ..Job::default()
    };
    let frames = Job::default().make(std::slice::from_ref(&second));
    let frames = frames.expect("a motion").examples[0].frames();
    let alone = Job {
        length: Some(Length::Frames(frames)),
        ..Job::default()
    };
    let rows = [
        ("legs of the second".to_string(), of_seeds(fixed)),
        ("first alone".to_string(), of_seeds(alone)),
        ("manner, K 2".to_string(), same(style(2.0))),
        ("manner, K 5".to_string(), same(style(5.0))),
        ("manner, K 8".to_string(), same(style(8.0))),
    ];
    for (name, jobs) in rows {
        let values = jobs.iter().map(|job| {
            let made = job.make(std::slice::from_ref(&first)).expect("a motion");
            distances(&made, &made.synthesis.frames, &second)
        });
        print(&name, &values.collect::<Vec<_>>());
    }
    let made = Job::default()
        .make(std::slice::from_ref(&first))
        .expect("a motion");
    let frames = made.layout.to_frames(&second).expect("one skeleton");
    print("second as it is", &[distances(&made, &frames, &second)]);
}

/// Distances of a motion's windows to the windows of both files, over the legs' joints and all
/// others, and the motion's jerk.
fn distances(made: &Made, motion: &Frames, second: &Example) -> [f64; 6] {
    let layout = &made.layout;
    let both = [
        made.examples[0].clone(),
        layout.to_frames(second).expect("one skeleton"),
    ];
    let legs = Part::named("legs", &[], layout, "fixed part")
        .expect("legs")
        .joints;
    let columns = |of_legs: bool| -> Vec<usize> {
        let joints = (0..layout.joints().len()).filter(|joint| legs.contains(joint) == of_legs);
        joints.flat_map(|joint| layout.rotation_of(joint)).collect()
    };
    let to = |file: usize, of_legs: bool| {
        let columns = columns(of_legs);
        let measures = Measures::of(&motion.columns(&columns), &[both[file].columns(&columns)]);
        measures.expect("more than 30 frames").local_diversity
    };
    let jerk = |frames: &Frames| {
        let bvh: Bvh = layout.to_bvh(frames).expect("finite");
        percentile_95(&jerks(&bvh))
    };
    let usual = jerk(&both[0]).max(jerk(&both[1]));
    [
        to(0, false),
        to(1, false),
        to(0, true),
        to(1, true),
        correlation(
            &motion.columns(&columns(true)),
            &both[1].columns(&columns(true)),
        ),
        jerk(motion) / usual,
    ]
}

/// The correlation of two motions of one length over all frames and channels, each channel about its
/// mean.
fn correlation(one: &Frames, other: &Frames) -> f64 {
    let n = one.frames();
    let mut sums = [0.0; 3];
    for channel in 0..one.channels() {
        let about = |motion: &Frames| -> Vec<f64> {
            let values = (0..n).map(|t| f64::from(motion.frame(t)[channel]));
            let mean = values.clone().sum::<f64>() / n as f64;
            values.map(|value| value - mean).collect()
        };
        let (a, b) = (about(one), about(other));
        for (sum, (x, y)) in sums.iter_mut().zip([(&a, &b), (&a, &a), (&b, &b)]) {
            *sum += x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        }
    }
    sums[0] / (sums[1] * sums[2]).sqrt()
}

/// Prints the means, and the standard deviations of several rows.
fn print(name: &str, rows: &[[f64; 6]]) {
    let n = rows.len() as f64;
    let cells = (0..6).map(|column| {
        let mean = rows.iter().map(|row| row[column]).sum::<f64>() / n;
        let squares = rows
            .iter()
            .map(|row| (row[column] - mean).powi(2))
            .sum::<f64>();
        match rows.len() {
            1 => format!("{mean:.2}"),
            _ => format!("{mean:.2} ({:.2})", (squares / (n - 1.0)).sqrt()),
        }
    });
    println!("{name:20} {}", cells.collect::<Vec<_>>().join("  "));
}
