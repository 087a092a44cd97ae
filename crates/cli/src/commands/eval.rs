//! `kinegrad eval`

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use kinegrad_data::{DataKind, Dataset, Phrase};
use kinegrad_train::Config;
use kinegrad_train::checkpoint::Weights;
use kinegrad_train::device;
use kinegrad_train::systems::cc_motion::evaluate::{CondSource, Evaluation, EvaluationSettings, evaluate};
use kinegrad_train::checkpoint::resolve_checkpoint;
use kinegrad_train::systems::cc_motion::generate::Generator;

use super::sample::{sampling_of, scale, steps};
use crate::args::{CondName, EvalArguments};
use crate::comparison::Comparison;
use crate::failure::{Failure, UsageError};
use crate::progress::denoising_bar;

/// Evaluates each run, writes the reports and prints them.
pub fn run(arguments: EvalArguments) -> Result<ExitCode, Failure> {
    refuse_zero(&arguments)?;
    if super::eval_goals::are_of_clips(&arguments.runs)? {
        return super::eval_goals::run(&arguments);
    }
    // Whatever is wrong with any run is said before the first one costs minutes.
    let subjects: Vec<Subject> = arguments
        .runs
        .iter()
        .map(|run| Subject::open(run, &arguments))
        .collect::<Result<_, _>>()?;
    for subject in &subjects {
        make_folder(&subject.reports)?;
    }
    let mut evaluations = Vec::with_capacity(subjects.len());
    for subject in &subjects {
        evaluations.push(subject.evaluate(&arguments)?);
    }
    let mut written = Vec::new();
    match &arguments.out {
        Some(out) => {
            let comparison = Comparison::new(&arguments.runs, &evaluations);
            written.extend(write(out, cond(&arguments), &comparison)?);
        }
        None => {
            for (subject, evaluation) in subjects.iter().zip(&evaluations) {
                let alone = std::slice::from_ref(evaluation);
                let comparison = Comparison::new(&arguments.runs, alone);
                written.extend(write(&subject.reports, cond(&arguments), &comparison)?);
            }
        }
    }
    let comparison = Comparison::new(&arguments.runs, &evaluations);
    if arguments.json {
        say!("{}", comparison.json());
    } else {
        say!("{}", comparison.table());
        for path in written {
            say!("{}", path.display());
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn cond(arguments: &EvalArguments) -> CondName {
    arguments.cond.unwrap_or(CondName::Phrases)
}

fn refuse_zero(arguments: &EvalArguments) -> Result<(), UsageError> {
    if arguments.seeds == Some(0) {
        let hint = "draw at least one sample for each phrase; 2 tell how much two of them differ";
        return Err(UsageError::new("`--seeds` is 0", hint));
    }
    if arguments.phrases == Some(0) {
        let hint = "ask for at least one phrase, or leave it out for all that are held out";
        return Err(UsageError::new("`--phrases` is 0", hint));
    }
    Ok(())
}

/// A run with all that its evaluation needs, checked.
struct Subject {
    checkpoint: PathBuf,
    device: String,
    config: Config,
    held_out: Vec<Arc<Phrase>>,
    training: Vec<Arc<Phrase>>,
    settings: EvaluationSettings,
    reports: PathBuf,
}

impl Subject {
    fn open(run: &Path, arguments: &EvalArguments) -> Result<Self, Failure> {
        let checkpoint = resolve_checkpoint(run, |damaged| tell!("warning: {damaged}"))?;
        let given = [arguments.steps.map(steps), arguments.guidance_scale.map(scale)];
        let config = sampling_of(&checkpoint, &arguments.overrides, given)?;
        let device = arguments.device.clone();
        let device = device.unwrap_or_else(|| config.run.device.clone());
        device::open(&device)?;
        let mut data = config.data.clone();
        if let Some(source) = &arguments.source {
            data.kind = DataKind::Phrases;
            data.source = Some(source.clone());
        }
        let dataset = Dataset::open(&data)?;
        if dataset.validation.is_empty() {
            let message = format!(
                "no phrase is held out for {}: all {} are trained on",
                run.display(),
                dataset.train.len()
            );
            let hint = "its config's `data.validation` holds out none of them; give a dataset \
                        that it does with `--source URI`, or train with another \
                        `data.validation`";
            return Err(UsageError::new(message, hint).into());
        }
        let limit = arguments.phrases.unwrap_or(usize::MAX);
        let mut held_out = dataset.validation.load()?;
        held_out.truncate(limit);
        let settings = EvaluationSettings {
            seeds: arguments.seeds.unwrap_or(2),
            seed: arguments.seed,
            cond: match cond(arguments) {
                CondName::Phrases => CondSource::Phrases,
                CondName::Noise => CondSource::Noise,
            },
            sampling: config.sampling.clone(),
        };
        let reports = match &arguments.out {
            Some(out) => out.clone(),
            None => run_folder(&checkpoint).join("reports"),
        };
        Ok(Self {
            checkpoint,
            device,
            config,
            held_out,
            training: dataset.train.load()?,
            settings,
            reports,
        })
    }

    fn evaluate(&self, arguments: &EvalArguments) -> Result<Evaluation, Failure> {
        let weights = if arguments.no_ema {
            Weights::Model
        } else {
            Weights::Ema
        };
        let (device, _) = device::open(&self.device)?;
        let generator = Generator::load(&self.checkpoint, weights, &device)?;
        let bar = denoising_bar().with_prefix(format!("{}  ", self.config.run.name));
        let evaluation = evaluate(
            &generator,
            &self.held_out,
            &self.training,
            &self.settings,
            &mut |step, total| {
                bar.set_length(total as u64);
                bar.set_position(step as u64);
            },
        )?;
        bar.finish_and_clear();
        Ok(evaluation)
    }
}

/// The run that a checkpoint belongs to; a checkpoint that was moved away stands for itself.
pub fn run_folder(checkpoint: &Path) -> &Path {
    let inside = checkpoint
        .parent()
        .filter(|folder| folder.ends_with("checkpoints"));
    inside.and_then(Path::parent).unwrap_or(checkpoint)
}

pub fn make_folder(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| {
        let message = format!("cannot create the folder {}: {error}", folder.display());
        let hint = "give a folder that can be written with `--out DIR`";
        UsageError::new(message, hint).into()
    })
}

/// Writes the report in both forms and returns where.
fn write(folder: &Path, cond: CondName, comparison: &Comparison) -> Result<[PathBuf; 2], Failure> {
    let stem = match cond {
        CondName::Phrases => "eval",
        CondName::Noise => "eval-noise",
    };
    let [json, csv] = ["json", "csv"].map(|ending| folder.join(format!("{stem}.{ending}")));
    for (path, text) in [(&json, comparison.json() + "\n"), (&csv, comparison.csv())] {
        // A crash between the two leaves the report that was there.
        let temporary = path.with_extension("partial");
        std::fs::write(&temporary, text)
            .and_then(|()| std::fs::rename(&temporary, path))
            .map_err(kinegrad_train::Error::io("write", path))?;
    }
    Ok([json, csv])
}
