//! `kinegrad train`

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use kinegrad_data::{Dataset, write_motion};
use kinegrad_train::Ending;
use kinegrad_train::checkpoint::Weights;
use kinegrad_train::checkpoint::resolve_checkpoint;
use kinegrad_train::systems::cc_motion::generate::Generator;
use kinegrad_train::run::{self, Outcome, TrainRequest};
use kinegrad_train::systems::BUILT_IN;

use super::check::sanity_table;
use crate::args::TrainArguments;
use crate::failure::Failure;
use crate::output::table;
use crate::progress::{TrainProgress, duration};

/// Trains, then draws the samples that the config asks for.
pub fn run(arguments: TrainArguments) -> Result<ExitCode, Failure> {
    let mut overrides = arguments.overrides;
    for (key, value) in [
        ("run.name", arguments.name),
        ("run.device", arguments.device),
    ] {
        if let Some(value) = value {
            // Quoted, so that a name of digits stays a name.
            overrides.push(format!("{key}={}", serde_json::Value::from(value)));
        }
    }
    let request = TrainRequest {
        config: arguments.config,
        overrides,
        runs_dir: arguments.runs_dir,
        resume: arguments.resume,
    };
    let started = Instant::now();
    let mut progress = TrainProgress::new();
    let outcome = run::train(BUILT_IN, &request, &mut progress);
    progress.finish();
    let outcome = outcome?;
    summarise(&outcome, started);
    if outcome.ending == Some(Ending::Interrupted) {
        return Ok(ExitCode::from(130));
    }
    if outcome.ending.is_some() && outcome.config.sampling.count_at_end > 0 {
        draw_samples(&outcome)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn summarise(outcome: &Outcome, started: Instant) {
    let ending = match outcome.ending {
        None => "finished before, nothing to do",
        Some(Ending::Finished) => "finished",
        Some(Ending::EarlyStopped) => "stopped early: the validation loss no longer falls",
        Some(Ending::Interrupted) => "stopped; `--resume` continues",
    };
    let mut rows = vec![
        vec!["run".to_string(), outcome.folder.display().to_string()],
        vec!["ended".to_string(), ending.to_string()],
        vec!["steps".to_string(), outcome.step.to_string()],
    ];
    if let (Some(step), Some(loss)) = (outcome.progress.best_step, outcome.progress.best_val_loss) {
        rows.push(vec![
            "best val_loss".to_string(),
            format!("{loss:.5} at step {step}"),
        ]);
    }
    rows.push(vec![
        "time".to_string(),
        duration(started.elapsed().as_secs_f64()),
    ]);
    say!("{}", table(rows));
}

/// Draws samples for the first held-out phrases into the run's folder and checks them.
fn draw_samples(outcome: &Outcome) -> Result<(), Failure> {
    let sampling = &outcome.config.sampling;
    let path = resolve_checkpoint(&outcome.folder, |damaged| tell!("warning: {damaged}"))?;
    let (device, _) = kinegrad_train::device::open(&outcome.config.run.device)?;
    let generator = Generator::load(&path, Weights::Ema, &device)?;
    let dataset = Dataset::open(&outcome.config.data)?;
    let phrases = match dataset.validation.is_empty() {
        true => &dataset.train,
        false => &dataset.validation,
    };
    let chosen: Vec<_> = (0..sampling.count_at_end.min(phrases.len()))
        .map(|position| phrases.get(position))
        .collect::<Result<_, _>>()?;
    let frames = chosen.iter().map(|p| p.audio.frames()).min().unwrap_or(0);
    let conditions: Vec<_> = chosen.iter().map(|p| p.audio.slice(0..frames)).collect();
    let seed = outcome.config.run.seed;
    let samples = generator.sample(
        &conditions,
        sampling,
        seed,
        &mut |_, _| {},
    )?;
    let folder = outcome.folder.join("samples");
    let mut named = Vec::new();
    for (phrase, sample) in chosen.iter().zip(samples) {
        write(&folder, &format!("{}.raw.npy", phrase.id), &sample.raw)?;
        write(&folder, &format!("{}.npy", phrase.id), &sample.motion)?;
        named.push((phrase.id.clone(), sample.motion));
    }
    say!(
        "\n{} samples of step {} in {}",
        named.len(),
        generator.step(),
        folder.display()
    );
    say!("{}", sanity_table(&named, generator.statistics())?);
    Ok(())
}

fn write(folder: &Path, name: &str, motion: &kinegrad_motion::Motion) -> Result<(), Failure> {
    Ok(write_motion(&folder.join(name), motion)?)
}
