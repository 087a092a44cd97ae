//! Accuracy of a motion model at the end of sampling: held-out clips are noised to a timestep and
//! predicted once, with the condition only and with guidance.
//!
//! ```sh
//! cargo run --release -p kinegrad-gmd --example predict_once -- runs/gmd_motion 0 20 100
//! ```
//!
//! For each timestep and scale, the example prints mean distances from the clip (root; other joints
//! relative to the root), and the ratio of the jerk to the clips' jerk.

use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::Clip;
use kinegrad_gmd::{ClipGenerator, Gmd};
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::metrics::mean_jerk;
use kinegrad_train::checkpoint::{Weights, resolve_checkpoint};
use kinegrad_train::{Error, Systems};

/// Held-out clips that are predicted.
const CLIPS: usize = 32;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let timesteps = arguments.iter().skip(1).map(|text| text.parse());
    let (Some(run), Ok(timesteps)) = (arguments.first(), timesteps.collect::<Result<Vec<_>, _>>())
    else {
        eprintln!("usage: predict_once RUN TIMESTEP...");
        return ExitCode::from(2);
    };
    match report(Path::new(run), &timesteps) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn report(run: &Path, timesteps: &[usize]) -> Result<(), Error> {
    let saved = resolve_checkpoint(run, |_| {})?;
    let trained = Systems(&[&Gmd]).trained(saved, &[], Weights::Ema, Some("cpu"))?;
    let generator = ClipGenerator::load(&trained)?;
    let data = &generator.config().data;
    let clips = Dataset::<Clip>::open(data)?.validation.evenly(CLIPS)?;
    if clips.is_empty() {
        let hint = "set `data.validation` or `data.humanml3d.validation_list` in the run's config";
        return Err(Error::usage("the run holds no clip out", hint));
    }
    let real = clips.iter().map(|clip| {
        let length = clip.features.frames().min(data.target_frames);
        clip.features.slice(0..length).to_absolute().joints()
    });
    let real: Vec<Joints> = real.collect();
    let fps = data.humanml3d.skeleton().description().fps;
    let jerk = |all: &[Joints]| {
        let each = all.iter().filter_map(|joints| mean_jerk(joints, fps));
        each.sum::<f64>() / all.len() as f64
    };
    println!("timestep  scale  root, cm  joints about it, cm  jerk over the clips'");
    for &timestep in timesteps {
        for scale in [1.0, generator.config().sampling.sampler.guidance_scale] {
            let features = generator.predict_once(&clips, timestep, scale, 0)?;
            let predicted: Vec<Joints> = features.iter().map(|found| found.joints()).collect();
            let pairs = || predicted.iter().zip(&real);
            let root = mean(pairs().flat_map(|(a, b)| frames(a, b, |a, b| apart(a[0], b[0]))));
            let body = mean(pairs().flat_map(|(a, b)| {
                frames(a, b, |a, b| {
                    let each = (1..a.len()).map(|j| apart(minus(a[j], a[0]), minus(b[j], b[0])));
                    mean(each)
                })
            }));
            println!(
                "{timestep:>8}  {scale:>5}  {:>8.2}  {:>19.2}  {:>20.2}",
                100.0 * root,
                100.0 * body,
                jerk(&predicted) / jerk(&real)
            );
        }
    }
    Ok(())
}

/// The number `of` a frame, for each frame of both motions.
fn frames(a: &Joints, b: &Joints, of: impl Fn(&[[f64; 3]], &[[f64; 3]]) -> f64) -> Vec<f64> {
    (0..a.frames())
        .map(|t| of(a.frame(t), b.frame(t)))
        .collect()
}

fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values
        .into_iter()
        .fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count.max(1))
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    minus(a, b).iter().map(|d| d * d).sum::<f64>().sqrt()
}
