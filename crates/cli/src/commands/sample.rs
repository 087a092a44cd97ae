//! `kinegrad sample`

use std::path::Path;
use std::process::ExitCode;

use kinegrad_report::rows;
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights, resolve_checkpoint};
use kinegrad_train::config::environment;
use kinegrad_train::sampling::{BestOf, Request, Summary};
use kinegrad_train::{Error, ProcessGroup, Systems, TrainedModel};
use serde::Serialize;

use crate::args::{SampleArguments, SamplerArguments};
use crate::io::{Files, Written, exit_code};
use crate::{interrupt, output};

/// Generates motion and writes it to files.
pub fn run(systems: Systems<'_>, arguments: SampleArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    while_it_is_trained(|| sample(systems, arguments.clone()))
}

/// Largest number of attempts to find a checkpoint.
const ATTEMPTS: usize = 5;

/// Reads a checkpoint with `read`. Tries again if a running training has removed the checkpoint.
pub fn while_it_is_trained<T>(mut read: impl FnMut() -> Result<T, Error>) -> Result<T, Error> {
    for _ in 1..ATTEMPTS {
        match read() {
            Err(Error::CheckpointDamaged { path, .. }) if !path.exists() => {}
            done => return done,
        }
    }
    read()
}

fn sample(systems: Systems<'_>, arguments: SampleArguments) -> Result<ExitCode, Error> {
    let scales = arguments.sampler.guidance_scale.len();
    if scales > 1 {
        let message = format!("`--guidance-scale` names {scales} scales");
        let hint = "give one; `kinegrad eval --audio-ablation` compares several";
        return Err(Error::usage(message, hint));
    }
    let mut files = Files::new(&arguments.out, arguments.overwrite)?;
    (files.lock_feet, files.collects) = (arguments.lock_feet, arguments.json);
    files.allows_unusable = arguments.allow_unusable;
    let mut sampler = arguments.sampler.clone();
    let method = arguments.conditions.method.iter();
    sampler
        .overrides
        .extend(method.map(|method| format!("evaluation.path.method={method}")));
    let trained = trained(systems, &arguments.run, &sampler)?;
    let goal = match &arguments.conditions.goal[..] {
        [goal] => Some(goal.clone()),
        _ => None,
    };
    let request = Request {
        history_joints: arguments.conditions.history_joints()?,
        conditions: arguments.conditions.conditions()?,
        count: arguments.count,
        frames: arguments.frames,
        seconds: arguments.seconds,
        seed: arguments.seed,
        post_processing: arguments.postprocess,
        best_of: arguments.best_of.map(|count| BestOf {
            count,
            by: arguments.select_by.clone(),
        }),
    };
    let summary = systems.sample(&trained, &request, &mut files)?;
    match arguments.json {
        true => output::json(&Results {
            samples: files.collected,
            remark: summary.map(|summary| match summary {
                Summary::Text(text) => serde_json::json!(text),
                Summary::Table(table) => serde_json::json!(table),
            }),
        }),
        false => {
            say_summary(summary);
            output::how_to_view(&files.motions, goal.as_deref());
        }
    }
    let advice = "train longer, or sample again with another `--seed`";
    Ok(exit_code(files.unusable, "sample", advice))
}

/// All samples, for programs.
#[derive(Serialize)]
struct Results {
    samples: Vec<Written>,
    #[serde(skip_serializing_if = "Option::is_none")]
    remark: Option<serde_json::Value>,
}

/// The checkpoint of a run, or the one at `path`.
pub fn checkpoint(path: &Path) -> Result<SavedCheckpoint, Error> {
    resolve_checkpoint(path, |damaged| {
        // A running training may have removed the checkpoint.
        let gone = matches!(damaged, Error::CheckpointDamaged { path, .. } if !path.exists());
        if !gone {
            tell!("warning: {damaged}");
        }
    })
}

/// The model of a run or checkpoint, with the settings of the command line.
pub fn trained(
    systems: Systems<'_>,
    run: &Path,
    arguments: &SamplerArguments,
) -> Result<TrainedModel, Error> {
    trained_for(systems, run, arguments, &ProcessGroup::alone())
}

/// [`trained`], on the device of this rank.
pub fn trained_for(
    systems: Systems<'_>,
    run: &Path,
    arguments: &SamplerArguments,
    group: &ProcessGroup,
) -> Result<TrainedModel, Error> {
    let SamplerArguments {
        overrides,
        steps,
        guidance_scale,
        style_guidance_scale,
        no_ema,
        device,
    } = arguments;
    let mut overrides = overrides.clone();
    overrides.extend(steps.map(|n| format!("sampling.sampler.num_inference_steps={n}")));
    // `{:?}` writes whole numbers as TOML floats.
    match guidance_scale[..] {
        [] => {}
        [scale] => overrides.push(format!("sampling.sampler.guidance_scale={scale:?}")),
        ref several => overrides.push(format!("evaluation.guidance_scales={several:?}")),
    }
    let of_style = style_guidance_scale;
    overrides.extend(of_style.map(|s| format!("sampling.sampler.style_guidance_scale={s:?}")));
    let weights = match no_ema {
        true => Weights::Model,
        false => Weights::Ema,
    };
    let (saved, local) = (checkpoint(run)?, group.ranks().local().rank);
    let device = match device {
        Some(device) => Some(device.clone()),
        None => environment::device()?,
    };
    systems.trained_on_rank(saved, &overrides, weights, device.as_deref(), local)
}

/// Prints a summary of all samples.
pub fn say_summary(summary: Option<Summary>) {
    match summary {
        Some(Summary::Text(text)) => show!("{text}"),
        Some(Summary::Table(table)) => show!("{}", rows(table)),
        None => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_that_a_training_removed_is_searched_again() {
        let damaged = |path: &Path| Error::CheckpointDamaged {
            path: path.to_path_buf(),
            reason: "state.json: not found".into(),
        };
        let mut reads = 0;
        let read = while_it_is_trained(|| {
            reads += 1;
            match reads {
                1 | 2 => Err(damaged(Path::new("runs/none/checkpoints/step-00000004"))),
                _ => Ok(reads),
            }
        });
        assert_eq!(read.expect("the third"), 3);
        // An existing checkpoint that cannot be read is damaged.
        let mut reads = 0;
        let read = while_it_is_trained(|| -> Result<(), Error> {
            reads += 1;
            Err(damaged(Path::new("/")))
        });
        assert!(read.is_err());
        assert_eq!(reads, 1);
    }
}
