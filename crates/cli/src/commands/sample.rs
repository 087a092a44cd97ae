//! `kinegrad sample`

use std::path::{MAIN_SEPARATOR, Path, PathBuf};
use std::process::ExitCode;

use kinegrad_capture::Bvh;
use kinegrad_data::write_values;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_report::rows;
use kinegrad_train::Error;
use kinegrad_train::checkpoint::{Weights, resolve_checkpoint};
use kinegrad_train::sampling::{
    self, Conditions, Contents, Drawn, Receiver, Remark, Request, Subject,
};
use kinegrad_train::systems::Systems;

use crate::args::{DrawArguments, SampleArguments};
use crate::output::unusable;
use crate::progress::Denoising;

/// Units of a BVH file in a metre.
const CENTIMETRES: f64 = 100.0;

/// Generates motion and writes it to files.
pub fn run(systems: Systems<'_>, arguments: SampleArguments) -> Result<ExitCode, Error> {
    while_it_is_trained(|| draw(systems, arguments.clone()))
}

/// How often another checkpoint is looked for.
const ATTEMPTS: usize = 5;

/// Does what reads a run's checkpoint, again if a training that goes on removed it meanwhile.
pub fn while_it_is_trained<T>(mut read: impl FnMut() -> Result<T, Error>) -> Result<T, Error> {
    for _ in 1..ATTEMPTS {
        match read() {
            Err(Error::CheckpointDamaged { path, .. }) if !path.exists() => {}
            done => return done,
        }
    }
    read()
}

fn draw(systems: Systems<'_>, arguments: SampleArguments) -> Result<ExitCode, Error> {
    let mut files = Files::new(&arguments.out)?;
    let subject = subject(systems, &arguments.run, &arguments.draw)?;
    let trajectory = arguments.trajectory_run.as_deref().map(checkpoint);
    let request = Request {
        conditions: Conditions {
            source: arguments.source,
            item: arguments.phrase,
            audio_features: arguments.cond,
            song: arguments.audio,
            start: arguments.start,
            goals: arguments.goal,
            trajectory: trajectory.transpose()?,
            text_embedding: arguments.text_embedding,
            held_out: None,
        },
        count: arguments.count,
        frames: arguments.frames,
        seed: arguments.seed,
    };
    let remark = sampling::sample(systems, &subject, &request, &mut files)?;
    say_remark(remark);
    Ok(ExitCode::SUCCESS)
}

/// The checkpoint that a path means.
pub fn checkpoint(path: &Path) -> Result<PathBuf, Error> {
    resolve_checkpoint(path, |damaged| {
        // A training beside this process may have removed it.
        let gone = matches!(damaged, Error::CheckpointDamaged { path, .. } if !path.exists());
        if !gone {
            tell!("warning: {damaged}");
        }
    })
}

/// The model of a run or checkpoint, with the settings of the command line.
pub fn subject(
    systems: Systems<'_>,
    run: &Path,
    arguments: &DrawArguments,
) -> Result<Subject, Error> {
    let DrawArguments {
        overrides,
        steps,
        guidance_scale,
        no_ema,
        device,
    } = arguments;
    let mut overrides = overrides.clone();
    overrides.extend(steps.map(|n| format!("sampling.sampler.num_inference_steps={n}")));
    // A whole number has a point in TOML if it is no integer.
    overrides.extend(guidance_scale.map(|s| format!("sampling.sampler.guidance_scale={s:?}")));
    let weights = match no_ema {
        true => Weights::Model,
        false => Weights::Ema,
    };
    systems.trained(&checkpoint(run)?, &overrides, weights, device.as_deref())
}

/// Prints what is to be said of all motions.
pub fn say_remark(remark: Option<Remark>) {
    match remark {
        Some(Remark::Text(text)) => say!("{text}"),
        Some(Remark::Table(table)) => say!("{}", rows(table)),
        None => {}
    }
}

/// Rejects a motion whose numbers are not finite; `stem` begins the names of its files.
///
/// # Errors
/// Names the first file.
pub fn must_be_finite(drawn: &Drawn, stem: &str) -> Result<(), Error> {
    for (ending, contents) in &drawn.files {
        if let Contents::Array { values, .. } = contents
            && !values.iter().all(|value| value.is_finite())
        {
            let sample = format!("{stem}{}{ending}", drawn.name);
            return Err(Error::SampleNotFinite { sample });
        }
    }
    Ok(())
}

/// The text of the BVH file of joint positions, in centimetres.
///
/// # Errors
/// If they cannot be written as BVH.
pub fn bvh_text(joints: &Joints, skeleton: &Skeleton) -> Result<String, Error> {
    let bvh = Bvh::from_joints(joints, skeleton, CENTIMETRES).map_err(unusable)?;
    Ok(bvh.to_text())
}

/// Writes motion to files of one stem.
pub struct Files {
    stem: String,
    bar: Option<Denoising>,
    says: bool,
    written: usize,
}

impl Files {
    /// Files with the prefix `out`; each is printed.
    ///
    /// # Errors
    /// If `out` names a folder: the files would have no name.
    fn new(out: &Path) -> Result<Self, Error> {
        let text = out.to_string_lossy();
        let stem = text.strip_suffix(".npy").unwrap_or(&text);
        let name = stem.rsplit(['/', MAIN_SEPARATOR]).next();
        if matches!(name, None | Some("" | "." | "..")) {
            let folder = match stem {
                "" => "./",
                folder => folder,
            };
            return Err(Error::usage(
                format!(
                    "`--out {text}` names no file: it is the beginning of a path, such as dances/one"
                ),
                format!(
                    "for files in that folder: `--out {}`",
                    Path::new(folder).join("sample").display()
                ),
            ));
        }
        Ok(Self {
            stem: stem.to_string(),
            bar: None,
            says: true,
            written: 0,
        })
    }

    /// Files with the prefix `out` that are not printed.
    ///
    /// # Errors
    /// If `out` names a folder.
    pub fn unprinted(out: &Path) -> Result<Self, Error> {
        let files = Self::new(out)?;
        Ok(Self {
            says: false,
            ..files
        })
    }

    /// Files in `folder` that are not printed.
    pub fn silent(folder: &Path) -> Self {
        Self {
            stem: format!("{}/", folder.display()),
            bar: None,
            says: false,
            written: 0,
        }
    }

    /// Writes a motion and returns its files, the motion itself first.
    ///
    /// # Errors
    /// If it is not finite, or a file cannot be written.
    pub fn write(&mut self, drawn: &Drawn) -> Result<Vec<PathBuf>, Error> {
        must_be_finite(drawn, &self.stem)?;
        let mut written = Vec::with_capacity(drawn.files.len());
        for (ending, contents) in &drawn.files {
            let path = PathBuf::from(format!("{}{}{ending}", self.stem, drawn.name));
            match contents {
                Contents::Array { shape, values } => write_values(&path, shape, values)?,
                Contents::Figure { joints, skeleton } => {
                    let text = bvh_text(joints, skeleton)?;
                    std::fs::write(&path, text).map_err(Error::io("write", &path))?;
                }
            }
            written.push(path);
        }
        self.written += 1;
        Ok(written)
    }

    /// Motions written so far.
    pub fn written(&self) -> usize {
        self.written
    }
}

impl Receiver for Files {
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize) {
        let bar = self.bar.get_or_insert_with(|| Denoising::of(""));
        bar.show(stage, done, all);
    }

    fn drawn(&mut self, drawn: Drawn) -> Result<(), Error> {
        if let Some(bar) = self.bar.take() {
            bar.finish();
        }
        let written = self.write(&drawn)?;
        if let (true, Some(path)) = (self.says, written.first()) {
            say!("{}", path.display());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_that_a_training_removed_is_looked_for_again() {
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
        // One that is there is damaged.
        let mut reads = 0;
        let read = while_it_is_trained(|| -> Result<(), Error> {
            reads += 1;
            Err(damaged(Path::new("/")))
        });
        assert!(read.is_err());
        assert_eq!(reads, 1);
    }
}
