//! Measures of new motions of BVH files under several settings, averaged over seeds.
//!
//! ```sh
//! cargo run --release -p kinegrad-matching --example matching_table -- \
//!     --seeds 5 --joints Hips,Spine dance.bvh
//! ```
//!
//! prints one table with all files together as examples: the presets, then K, alpha, patch size,
//! pyramid ratio, steps, parts and coherence, each changed alone. `--presets` limits the table to
//! the presets. `--joints` names the measured joints; the default is all joints.

use std::time::Instant;

use kinegrad_matching::{CoarseRatio, Example, Job, Measures, PartChoice, Preset, Settings};

mod common;

use common::read;

/// A change of the settings.
type Change = Box<dyn Fn(&mut Job)>;

fn main() {
    let (mut seeds, mut joints, mut files) = (5, Vec::new(), Vec::new());
    let mut quick = false;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--seeds" => {
                seeds = arguments
                    .next()
                    .and_then(|n| n.parse().ok())
                    .expect("a number")
            }
            "--joints" => {
                let names = arguments.next().expect("names");
                joints = names.split(',').map(String::from).collect();
            }
            "--presets" => quick = true,
            file => files.push(file.to_string()),
        }
    }
    let examples: Vec<Example> = files.iter().map(|file| read(file)).collect();
    let names = examples[0]
        .bvh
        .joints()
        .iter()
        .map(|joint| joint.name.as_str());
    let bare = |name: &str| name.rsplit(':').next().unwrap_or(name).to_string();
    let measured: Vec<usize> = names
        .enumerate()
        .filter(|(_, name)| joints.contains(&bare(name)))
        .map(|(index, _)| index)
        .collect();
    println!("joints measured: {} (0: all)", measured.len());
    println!(
        "{:24} {:>14} {:>14} {:>14} {:>14} {:>14} {:>14} {:>12} {:>9}",
        "setting",
        "coverage",
        "window cost",
        "local",
        "global",
        "novelty",
        "copied",
        "splices/s",
        "seconds"
    );
    for (name, change) in changes(quick) {
        row(&name, &change, &examples, seeds, &measured);
    }
}

fn changes(presets_alone: bool) -> Vec<(String, Change)> {
    let mut changes: Vec<(String, Change)> = vec![("published".into(), Box::new(|_| {}))];
    let mut add = |name: String, change: Change| changes.push((name, change));
    add(
        "K 4, E 5".into(),
        Box::new(|job| {
            job.settings.coarse_ratio = CoarseRatio::Patches(4.0);
            job.settings.num_steps = 5;
        }),
    );
    add(
        "alpha 10".into(),
        Box::new(|job| job.settings.alpha = Some(10.0)),
    );
    add(
        "paper".into(),
        Box::new(|job| {
            job.settings = Settings::of(Preset::Paper);
            job.parts = PartChoice::Automatic;
            job.contacts = true;
        }),
    );
    if presets_alone {
        return changes;
    }
    for k in [2.0, 3.0, 4.0, 8.0, 12.0] {
        let set = move |job: &mut Job| job.settings.coarse_ratio = CoarseRatio::Patches(k);
        add(format!("K {k}"), Box::new(set));
    }
    for alpha in [0.0001, 0.001, 0.1, 1.0] {
        let set = move |job: &mut Job| job.settings.alpha = Some(alpha);
        add(format!("alpha {alpha}"), Box::new(set));
    }
    add(
        "alpha none".into(),
        Box::new(|job| job.settings.alpha = None),
    );
    for p in [5, 7, 15, 21] {
        let set = move |job: &mut Job| job.settings.patch_size = p;
        add(format!("patch size {p}"), Box::new(set));
    }
    for factor in [0.5, 0.65, 0.85, 0.95] {
        let set = move |job: &mut Job| job.settings.pyr_factor = factor;
        add(format!("pyramid ratio {factor}"), Box::new(set));
    }
    for steps in [1, 2, 5, 10] {
        let set = move |job: &mut Job| job.settings.num_steps = steps;
        add(format!("steps {steps}"), Box::new(set));
    }
    add(
        "parts".into(),
        Box::new(|job| job.parts = PartChoice::Automatic),
    );
    for coherence in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let set = move |job: &mut Job| {
            let settings = job.settings.clone();
            job.settings = settings.with_coherence(coherence).expect("0 to 1");
        };
        add(format!("coherence {coherence}"), Box::new(set));
    }
    changes
}

fn row(name: &str, change: &Change, examples: &[Example], seeds: u64, joints: &[usize]) {
    let mut columns: [Vec<f64>; 8] = Default::default();
    for seed in 0..seeds {
        let mut job = Job {
            seed,
            ..Job::default()
        };
        change(&mut job);
        let start = Instant::now();
        let made = match job.make(examples) {
            Ok(made) => made,
            Err(error) => {
                println!("{name:24} {error}");
                return;
            }
        };
        let seconds = start.elapsed().as_secs_f64();
        let Some(measures) = made.measures(joints) else {
            println!("{name:24} too short or too long to be measured");
            return;
        };
        let Measures {
            coverage,
            window_cost,
            local_diversity,
            global_diversity,
            novelty,
            ..
        } = measures;
        let runs = made.novelty()[0];
        let values = [
            coverage,
            window_cost,
            local_diversity,
            global_diversity.unwrap_or(f64::NAN),
            novelty.unwrap_or(f64::NAN),
            runs.copied,
            runs.splices_per_second,
            seconds,
        ];
        for (column, value) in columns.iter_mut().zip(values) {
            column.push(value);
        }
    }
    let cells = columns.map(|values| {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>();
        (mean, (square / (n - 1.0).max(1.0)).sqrt())
    });
    let [
        coverage,
        cost,
        local,
        global,
        novelty,
        copied,
        splices,
        seconds,
    ] = cells;
    let spread = |(mean, deviation): (f64, f64)| format!("{mean:.3} ({deviation:.3})");
    println!(
        "{name:24} {:>14} {:>14} {:>14} {:>14} {:>14} {:>14} {:>12.2} {:>9.3}",
        spread(coverage),
        spread(cost),
        spread(local),
        spread(global),
        spread(novelty),
        spread(copied),
        splices.0,
        seconds.0
    );
}
