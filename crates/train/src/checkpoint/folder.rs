use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use kinegrad_data::file::{MAX_TEXT_BYTES, read_file};
use kinegrad_models::parameters::ParameterInfo;
use kinegrad_output::UnfinishedFolder;

use super::tensors::{OPTIMIZER, Weights, write};
use super::{Best, Checkpoint, State, broken_weights};
use crate::optim::Moments;
use crate::{Error, run};

/// Prefix of unfinished and removed items.
const UNFINISHED: &str = ".writing-";

/// The folder `checkpoints` of a run.
#[derive(Clone, Debug)]
pub struct Checkpoints {
    path: PathBuf,
}

impl Checkpoints {
    /// The checkpoints of the run in `run`.
    pub fn of(run: &Path) -> Self {
        Self {
            path: run.join("checkpoints"),
        }
    }

    /// The path of the checkpoint of `step`, existing or not.
    pub fn step_path(&self, step: u64) -> PathBuf {
        self.path.join(format!("step-{step:08}"))
    }

    /// Steps that have a checkpoint, valid or damaged, oldest first.
    ///
    /// # Errors
    /// If the folder cannot be listed.
    pub fn steps(&self) -> Result<Vec<u64>, Error> {
        let step = |name: String| name.strip_prefix("step-")?.parse().ok();
        let mut steps: Vec<u64> = self.names()?.into_iter().filter_map(step).collect();
        steps.sort_unstable();
        Ok(steps)
    }

    /// Names of the folder's contents.
    fn names(&self) -> Result<Vec<String>, Error> {
        let entries = match fs::read_dir(&self.path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(Error::io("list", &self.path))?,
        };
        let name = |entry: std::io::Result<fs::DirEntry>| {
            let entry = entry.map_err(Error::io("list", &self.path))?;
            Ok(entry.file_name().to_string_lossy().into_owned())
        };
        entries.map(name).collect()
    }

    /// The latest valid checkpoint, if the run has checkpoints; `skipped` is called for each
    /// damaged one.
    ///
    /// # Errors
    /// If all checkpoints are damaged, or a checkpoint cannot be read.
    pub fn newest_good(
        &self,
        mut skipped: impl FnMut(&Error),
    ) -> Result<Option<Checkpoint>, Error> {
        let steps = self.steps()?;
        let mut tried = Vec::new();
        for &step in steps.iter().rev() {
            match Checkpoint::read(&self.step_path(step)) {
                Ok(checkpoint) => return Ok(Some(checkpoint)),
                Err(error @ Error::CheckpointDamaged { .. }) => {
                    skipped(&error);
                    tried.push(format!("  {error}"));
                }
                Err(error) => return Err(error),
            }
        }
        if tried.is_empty() {
            return Ok(None);
        }
        Err(Error::NoGoodCheckpoint {
            path: self.path.clone(),
            tried: tried.join("\n"),
        })
    }

    /// The best step, if one is recorded.
    pub fn best(&self) -> Option<Best> {
        serde_json::from_slice(&read_file(&self.path.join("best.json"), MAX_TEXT_BYTES).ok()?).ok()
    }

    /// Starts a checkpoint that is written part by part.
    pub(crate) fn begin(&self, step: u64) -> Result<Unfinished, Error> {
        self.remove_unfinished()?;
        let temporary = UnfinishedFolder::within(&self.path);
        Ok(Unfinished {
            temporary: temporary.map_err(Error::io("create", &self.path))?,
            target: self.step_path(step),
            checksums: BTreeMap::new(),
        })
    }

    /// Records the best step, or removes the record.
    pub(crate) fn set_best(&self, best: Option<&Best>) -> Result<(), Error> {
        let target = self.path.join("best.json");
        let Some(best) = best else {
            return remove(&target);
        };
        let text = serde_json::to_string_pretty(best).expect("plain data") + "\n";
        let written = kinegrad_output::write(&target, text.as_bytes());
        written.map_err(Error::io("write", &target))?;
        flush_folder(&self.path)
    }

    /// Removes what interrupted processes left.
    fn remove_unfinished(&self) -> Result<(), Error> {
        let names = self.names()?.into_iter();
        let mut unfinished = names.filter(|name| name.starts_with(UNFINISHED));
        unfinished.try_for_each(|name| remove(&self.path.join(name)))
    }

    /// Removes unfinished files and old checkpoints. The newest `keep_last`, the best, and
    /// checkpoints after `current`, which a resumed run has not reached again, are kept.
    pub(crate) fn prune(
        &self,
        current: u64,
        keep_last: usize,
        best: Option<u64>,
    ) -> Result<(), Error> {
        self.remove_unfinished()?;
        let steps = self.steps()?.into_iter().rev();
        let superseded = steps.filter(|&step| step <= current).skip(keep_last);
        for step in superseded.filter(|&step| Some(step) != best) {
            remove(&self.step_path(step))?;
        }
        Ok(())
    }
}

/// Rejects a folder that is not empty, or whose name a run cannot have.
pub fn must_be_free(out: &Path) -> Result<(), Error> {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    if name.contains(char::is_control) {
        let message = format!("option `out` is {}", out.display());
        let hint = "the folder's name is the run's, which has no control characters";
        return Err(Error::usage(message, hint));
    }
    let taken = out
        .read_dir()
        .is_ok_and(|mut entries| entries.next().is_some());
    match taken || out.is_file() {
        true => Err(Error::usage(
            format!(
                "{} exists already and is not an empty folder",
                out.display()
            ),
            "choose another option `out`",
        )),
        false => Ok(()),
    }
}

/// Writes weights without an optimizer as the only checkpoint of the run in `out`.
pub fn write_weights(
    out: &Path,
    state: &State,
    infos: &[ParameterInfo],
    model: &[Vec<f32>],
    ema: &[Vec<f32>],
) -> Result<PathBuf, Error> {
    let broken = broken_weights(Weights::Model, infos, model);
    if let Some(tensor) = broken.or_else(|| broken_weights(Weights::Ema, infos, ema)) {
        return Err(Error::usage(
            format!("{tensor} contains a number that is not finite: nothing is written"),
            "such weights cannot be sampled; take those of an earlier step",
        ));
    }
    let mut unfinished = Checkpoints::of(out).begin(state.step)?;
    unfinished.write_weights(Weights::Model, infos, model)?;
    unfinished.write_weights(Weights::Ema, infos, ema)?;
    unfinished.write_moments(infos, &[])?;
    unfinished.finish(state)
}

/// A checkpoint being written; removed unless it is [finished](Self::finish).
pub(crate) struct Unfinished {
    temporary: UnfinishedFolder,
    target: PathBuf,
    checksums: BTreeMap<String, String>,
}

impl Unfinished {
    /// Writes the trained weights or their average, in the order of `infos`.
    ///
    /// # Errors
    /// If the weights cannot be written.
    pub fn write_weights(
        &mut self,
        weights: Weights,
        infos: &[ParameterInfo],
        values: &[Vec<f32>],
    ) -> Result<(), Error> {
        let tensors = infos
            .iter()
            .zip(values)
            .map(|(info, values)| (info.name.clone(), info.shape.as_slice(), values.as_slice()));
        self.write(weights.file(), tensors)
    }

    /// Writes the optimizer's running means, in the order of `infos`.
    ///
    /// # Errors
    /// If the running means cannot be written.
    pub fn write_moments(
        &mut self,
        infos: &[ParameterInfo],
        moments: &[Moments],
    ) -> Result<(), Error> {
        // Frozen parameters have no running means.
        let trained = infos.iter().zip(moments);
        let trained = trained.filter(|(info, moments)| moments.exp_avg.len() == info.len());
        let tensors = trained.flat_map(|(info, moments)| {
            let (name, shape) = (&info.name, info.shape.as_slice());
            [
                (format!("{name}.exp_avg"), shape, &moments.exp_avg[..]),
                (format!("{name}.exp_avg_sq"), shape, &moments.exp_avg_sq[..]),
            ]
        });
        self.write(OPTIMIZER, tensors)
    }

    fn write<'a>(
        &mut self,
        file: &str,
        tensors: impl IntoIterator<Item = (String, &'a [usize], &'a [f32])>,
    ) -> Result<(), Error> {
        let checksum = write(&self.temporary.path().join(file), tensors)?;
        self.checksums.insert(file.to_string(), checksum);
        Ok(())
    }

    /// Writes the state with checksums and moves the checkpoint into place.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn finish(self, state: &State) -> Result<PathBuf, Error> {
        let state = State {
            checksums: self.checksums.clone(),
            ..state.clone()
        };
        let text = state.to_text();
        let temporary = self.temporary.path();
        let path = temporary.join("state.json");
        kinegrad_output::write(&path, text.as_bytes()).map_err(Error::io("write", &path))?;
        flush_folder(temporary)?;
        // An unreadable checkpoint must not replace a readable one.
        State::read(temporary)?;
        // An existing checkpoint of this step is damaged, or older than a fallback to an earlier
        // checkpoint.
        remove(&self.target)?;
        let moved = self.temporary.finish(&self.target);
        moved.map_err(Error::io("rename", &self.target))?;
        flush_folder(self.target.parent().unwrap_or(&self.target))?;
        Ok(self.target)
    }
}

/// Removes a file or folder; a checkpoint is renamed first, so that a crash leaves no part of it.
fn remove(path: &Path) -> Result<(), Error> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if !path.is_dir() || name.starts_with(UNFINISHED) {
        return run::remove(path);
    }
    let doomed = path.with_file_name(format!("{UNFINISHED}removed-{name}"));
    // A killed process may have left a folder of this name.
    run::remove(&doomed)?;
    fs::rename(path, &doomed).map_err(Error::io("remove", path))?;
    run::remove(&doomed)
}

fn flush_folder(path: &Path) -> Result<(), Error> {
    let folder = fs::File::open(path).map_err(Error::io("open", path))?;
    folder.sync_all().map_err(Error::io("flush", path))
}
