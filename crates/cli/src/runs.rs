//! Run folders as they are found: what a run is, how far it has come, in which state it is.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use kinegrad_train::checkpoint::{Best, Checkpoints, State};
use kinegrad_train::run::{PREVIEWS, SAMPLES, is_in_use};
use kinegrad_train::systems::Systems;
use kinegrad_train::{Config, Error};

/// Folders within a run in which no run is looked for.
const INSIDE: [&str; 4] = ["checkpoints", "reports", SAMPLES, PREVIEWS];

/// How deep runs are looked for.
const DEPTH: usize = 6;

/// How much of the end of `metrics.jsonl` is read for its last step.
const TAIL: u64 = 16 << 10;

/// How a run stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// A process has it.
    Training,
    /// All steps are done.
    Finished,
    /// It ended before, because the validation loss no longer fell.
    StoppedEarly,
    /// It has a checkpoint to go on from.
    Stopped,
    /// It has no checkpoint yet.
    NeverBegun,
    /// Weights without a training: imported or merged.
    Weights,
    /// Its config or its checkpoints cannot be read.
    Damaged,
}

impl Standing {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Training => "training",
            Self::Finished => "finished",
            Self::StoppedEarly => "stopped early",
            Self::Stopped => "stopped",
            Self::NeverBegun => "never begun",
            Self::Weights => "weights only",
            Self::Damaged => "damaged",
        }
    }
}

/// A run as its folder shows it.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// How it stands.
    pub standing: Standing,
    /// What is wrong with it.
    pub problem: Option<String>,
    /// Its config, as far as one can be read.
    pub config: Option<Config>,
    /// Name of its system.
    pub system: Option<&'static str>,
    /// Names of the runs that its system trains before it.
    pub stages: &'static [&'static str],
    /// Steps done.
    pub step: u64,
    /// Its best validation.
    pub best: Option<Best>,
    /// The newest checkpoint whose state can be read, and that state.
    pub newest: Option<(PathBuf, State)>,
    /// Bytes on disk.
    pub bytes: u64,
    /// When something was last written that training writes.
    pub modified: Option<SystemTime>,
}

impl Run {
    /// Looks at the run in `folder`. What cannot be read is said in [`problem`](Self::problem).
    pub fn read(systems: Systems<'_>, folder: &Path) -> Self {
        let mut problem = None;
        let config = saved_config(systems, folder).unwrap_or_else(|error| {
            problem = Some(error.to_string());
            None
        });
        let checkpoints = Checkpoints::of(folder);
        let (newest, damaged) = newest(&checkpoints);
        // With an older checkpoint it goes on.
        let is_damaged = problem.is_some() || damaged.is_some() && newest.is_none();
        if let Some(error) = damaged {
            problem.get_or_insert(error.to_string());
        }
        let saved = newest.as_ref().map(|(_, state)| &state.config);
        let config = config.or_else(|| systems.completed(saved?).ok());
        let system = config.as_ref().and_then(|config| systems.of(config).ok());
        let step = newest.as_ref().map_or(0, |(_, state)| state.step);
        let metrics = folder.join("metrics.jsonl");
        let in_use = is_in_use(folder);
        let standing = match &newest {
            _ if in_use => Standing::Training,
            _ if is_damaged => Standing::Damaged,
            None => Standing::NeverBegun,
            Some(_) if !metrics.exists() && !folder.join("config.toml").exists() => {
                Standing::Weights
            }
            Some((_, state)) => ended(state, config.as_ref().unwrap_or(&state.config)),
        };
        let written = ["metrics.jsonl", "config.toml", "checkpoints"];
        let modified = written.iter().filter_map(|name| {
            let metadata = fs::metadata(folder.join(name)).ok()?;
            metadata.modified().ok()
        });
        Self {
            standing,
            problem,
            system: system.map(|(system, _)| system.name()),
            stages: system.map_or(&[], |(system, _)| system.stages()),
            config,
            // A training is further than its checkpoints.
            step: last_step(&metrics).filter(|_| in_use).unwrap_or(step),
            best: checkpoints.best(),
            newest,
            bytes: size_on_disk(folder, 0),
            modified: modified.max(),
            folder: folder.to_path_buf(),
        }
    }

    /// Its recipe.
    pub fn recipe(&self) -> Option<&str> {
        let config = self.config.as_ref()?;
        Some(&config.train.recipe)
    }

    /// Steps in all, of a run that is trained.
    pub fn max_steps(&self) -> Option<u64> {
        let config = self.config.as_ref()?;
        (self.standing != Standing::Weights).then_some(config.train.max_steps)
    }
}

/// The config beside the checkpoints, if there is one.
fn saved_config(systems: Systems<'_>, folder: &Path) -> Result<Option<Config>, Error> {
    let path = folder.join("config.toml");
    let exists = path.exists();
    let config = exists.then(|| systems.load(&path, &[])).transpose()?;
    Ok(config)
}

/// The newest checkpoint whose state can be read and whose files are there, and what is wrong with
/// newer ones: resuming passes over them too.
fn newest(checkpoints: &Checkpoints) -> (Option<(PathBuf, State)>, Option<Error>) {
    let steps = match checkpoints.steps() {
        Ok(steps) => steps,
        Err(error) => return (None, Some(error)),
    };
    let mut first = None;
    for step in steps.into_iter().rev() {
        let path = checkpoints.step_path(step);
        match State::read(&path) {
            Ok(state) => match state
                .checksums
                .keys()
                .find(|file| !path.join(file).exists())
            {
                None => return (Some((path, state)), first),
                Some(file) => {
                    let reason = format!("{file} is missing");
                    first.get_or_insert(Error::CheckpointDamaged { path, reason });
                }
            },
            // A training has removed it meanwhile.
            Err(_) if !path.exists() => {}
            Err(error) => {
                first.get_or_insert(error);
            }
        }
    }
    (None, first)
}

fn ended(state: &State, config: &Config) -> Standing {
    let patience = config.train.patience;
    match () {
        () if state.step >= config.train.max_steps => Standing::Finished,
        () if patience > 0 && state.progress.validations_since_best >= patience => {
            Standing::StoppedEarly
        }
        () => Standing::Stopped,
    }
}

/// The step of the last whole line of the metrics.
fn last_step(path: &Path) -> Option<u64> {
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))
        .ok()?;
    let mut tail = Vec::new();
    file.take(TAIL).read_to_end(&mut tail).ok()?;
    let tail = String::from_utf8_lossy(&tail);
    let whole = &tail[..tail.rfind('\n')?];
    let line: serde_json::Value = serde_json::from_str(whole.lines().last()?).ok()?;
    line.get("step")?.as_u64()
}

/// Bytes of all files below a folder; links count nothing.
fn size_on_disk(folder: &Path, depth: usize) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let sizes = entries.filter_map(|entry| {
        let metadata = entry.metadata().ok()?;
        Some(match metadata.is_dir() && depth < DEPTH {
            true => size_on_disk(&entry.path(), depth + 1),
            false if metadata.is_file() => metadata.len(),
            false => 0,
        })
    });
    sizes.sum()
}

/// Whether a folder is a run's: it holds what a training writes.
pub fn is_run(folder: &Path) -> bool {
    let written = ["checkpoints", "metrics.jsonl", "lock"];
    written.iter().any(|name| folder.join(name).exists())
}

/// The runs in a folder and below it, by path: the folder itself if it is one, and the stages that
/// runs hold.
pub fn find(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    search(folder, 0, &mut found);
    found
}

fn search(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    if is_run(folder) {
        found.push(folder.to_path_buf());
    }
    if depth == DEPTH {
        return;
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let folders = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
    let mut folders: Vec<PathBuf> = folders.map(|entry| entry.path()).collect();
    folders.sort();
    for path in folders {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !name.starts_with('.') && !INSIDE.contains(&&*name) {
            search(&path, depth + 1, found);
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_train::systems::BUILT_IN;

    use super::*;

    #[test]
    fn runs_are_found_in_folders_of_folders_and_not_inside_of_checkpoints() {
        let root = tempfile::tempdir().expect("a folder");
        for folder in [
            "one/checkpoints/step-00000001/checkpoints",
            "one/base/checkpoints",
            "more/deep/two/checkpoints",
            ".hidden/checkpoints",
            "empty",
        ] {
            fs::create_dir_all(root.path().join(folder)).expect("folders");
        }
        let found = find(root.path());
        let names: Vec<_> = found
            .iter()
            .map(|path| path.strip_prefix(root.path()).expect("below").to_path_buf())
            .collect();
        let expected = ["more/deep/two", "one", "one/base"];
        assert_eq!(names, expected.map(PathBuf::from));
        assert_eq!(find(&root.path().join("one/base")).len(), 1);
    }

    #[test]
    fn a_run_without_checkpoints_has_never_begun_and_a_bad_one_is_damaged() {
        let root = tempfile::tempdir().expect("a folder");
        let lock = root.path().join("lock");
        fs::write(&lock, "").expect("a lock");
        let standing = || Run::read(BUILT_IN, root.path()).standing;
        assert_eq!(standing(), Standing::NeverBegun);
        let checkpoint = root.path().join("checkpoints/step-00000004");
        fs::create_dir_all(checkpoint).expect("folders");
        assert_eq!(standing(), Standing::Damaged);
        let held = File::open(&lock).expect("the lock");
        held.try_lock().expect("locked");
        assert_eq!(standing(), Standing::Training);
    }

    #[test]
    fn the_last_step_is_that_of_the_last_whole_line() {
        let root = tempfile::tempdir().expect("a folder");
        let path = root.path().join("metrics.jsonl");
        assert_eq!(last_step(&path), None);
        let long = "x".repeat(2 * TAIL as usize);
        let text = format!("{{\"step\":1,\"a\":\"{long}\"}}\n{{\"step\":27,\"loss\":0.5}}\n{{\"st");
        fs::write(&path, text).expect("written");
        assert_eq!(last_step(&path), Some(27));
    }
}
