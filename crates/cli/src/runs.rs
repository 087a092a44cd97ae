//! Search for run folders, and their state and progress.

use std::collections::HashSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use kinegrad_data::file::regular;
use kinegrad_train::checkpoint::{Best, Checkpoints, State};
use kinegrad_train::run::{PREVIEWS, REPORTS, SAMPLES, is_in_use, saved_config};
use kinegrad_train::{Config, Error, Systems};

/// Subfolders of a run that contain no runs.
const INSIDE: [&str; 4] = ["checkpoints", REPORTS, SAMPLES, PREVIEWS];

/// Depth of the search for runs.
const DEPTH: usize = 6;

/// Bytes of the end of `metrics.jsonl` that are read for its last step.
const TAIL: u64 = 16 << 10;

/// Number of problems that are printed.
const NAMED: usize = 4;

/// The state of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunStatus {
    /// A process is training the run.
    Training,
    /// All steps are done.
    Finished,
    /// Training ended early: the validation loss no longer fell.
    StoppedEarly,
    /// The run has a checkpoint to resume from.
    Stopped,
    /// The run has no checkpoint yet.
    NotStarted,
    /// Imported or merged weights.
    Weights,
    /// The run's config or its checkpoints cannot be read.
    Damaged,
}

impl RunStatus {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Training => "training",
            Self::Finished => "finished",
            Self::StoppedEarly => "stopped early",
            Self::Stopped => "stopped",
            Self::NotStarted => "not started",
            Self::Weights => "weights only",
            Self::Damaged => "damaged",
        }
    }
}

/// A run folder.
#[derive(Clone, Debug)]
pub struct Run {
    pub folder: PathBuf,
    pub status: RunStatus,
    /// Problems of the run, in one line.
    pub problem: Option<String>,
    /// The run's config, if readable.
    pub config: Option<Config>,
    /// Name of the run's system.
    pub system: Option<&'static str>,
    /// Stages of the run's system.
    pub stages: &'static [&'static str],
    /// Steps done; `None` if no checkpoint can be read.
    pub step: Option<u64>,
    /// The run's best validation.
    pub best: Option<Best>,
    /// The newest checkpoint with a readable state, and the state.
    pub newest: Option<(PathBuf, State)>,
    /// Bytes on disk.
    pub bytes: u64,
    /// Time of the last change by training.
    pub modified: Option<SystemTime>,
}

impl Run {
    /// Reads a run folder; [`problem`](Self::problem) contains the errors.
    pub fn read(systems: Systems<'_>, folder: &Path) -> Self {
        let mut problem = None;
        let config = saved_config(systems, folder).unwrap_or_else(|error| {
            problem = Some(error.to_string());
            None
        });
        let checkpoints = Checkpoints::of(folder);
        let (newest, damaged) = found(&checkpoints);
        // A run can resume from an older checkpoint.
        let is_damaged = problem.is_some() || !damaged.is_empty() && newest.is_none();
        let unknown = newest.is_none() && !damaged.is_empty();
        problem = joined(problem.into_iter().chain(damaged));
        let saved = newest.as_ref().map(|(_, state)| &state.config);
        let config = config.or_else(|| systems.completed(saved?).ok());
        let system = config.as_ref().and_then(|config| systems.of(config).ok());
        let step = match &newest {
            Some((_, state)) => Some(state.step),
            None => (!unknown).then_some(0),
        };
        let metrics = folder.join("metrics.jsonl");
        let in_use = is_in_use(folder);
        let status = match &newest {
            _ if in_use => RunStatus::Training,
            _ if is_damaged => RunStatus::Damaged,
            None => RunStatus::NotStarted,
            Some(_) if !metrics.exists() && !folder.join("config.toml").exists() => {
                RunStatus::Weights
            }
            Some((_, state)) => ended(state, config.as_ref().unwrap_or(&state.config)),
        };
        let written = ["metrics.jsonl", "config.toml", "checkpoints"];
        let modified = written.iter().filter_map(|name| {
            let metadata = fs::metadata(folder.join(name)).ok()?;
            metadata.modified().ok()
        });
        Self {
            status,
            problem,
            system: system.map(|(system, _)| system.name()),
            stages: system.map_or(&[], |(system, _)| system.stages()),
            config,
            // A run in training is ahead of its checkpoints.
            step: last_step(&metrics).filter(|_| in_use).or(step),
            best: checkpoints.best(),
            newest,
            bytes: size_on_disk(folder, 0),
            modified: modified.max(),
            folder: folder.to_path_buf(),
        }
    }

    /// The run's recipe.
    pub fn recipe(&self) -> Option<&str> {
        let config = self.config.as_ref()?;
        Some(&config.train.recipe)
    }

    /// Steps done and total steps; `-` if unknown.
    pub fn steps(&self, number: impl Fn(u64) -> String) -> String {
        let done = self.step.map_or("-".to_string(), &number);
        match self.max_steps() {
            Some(all) => format!("{done} of {}", number(all)),
            None => done,
        }
    }

    /// Total steps; `None` for imported or merged weights.
    pub fn max_steps(&self) -> Option<u64> {
        let config = self.config.as_ref()?;
        let state = self.newest.as_ref().map(|(_, state)| state);
        (self.status != RunStatus::Weights).then(|| total_steps(config, state))?
    }
}

/// The newest complete checkpoint with its state, and the problems of damaged checkpoints, newest
/// first.
fn found(checkpoints: &Checkpoints) -> (Option<(PathBuf, State)>, Vec<String>) {
    let (mut newest, mut damaged) = (None, Vec::new());
    let steps = checkpoints.steps().unwrap_or_else(|error| {
        damaged.push(error.to_string());
        Vec::new()
    });
    for step in steps.into_iter().rev() {
        let path = checkpoints.step_path(step);
        match complete_state(&path) {
            Ok(state) if newest.is_none() => newest = Some((path, state)),
            Ok(_) => {}
            // Training has removed the checkpoint meanwhile.
            Err(_) if !path.exists() => {}
            Err(error) => damaged.push(error.to_string()),
        }
    }
    (newest, damaged)
}

/// The state of a checkpoint. Fails if the state is damaged or a file is missing; other files are
/// not read.
pub fn complete_state(checkpoint: &Path) -> Result<State, Error> {
    let state = State::read(checkpoint)?;
    let mut files = state.checksums.keys();
    match files.find(|file| !checkpoint.join(file).exists()) {
        None => Ok(state),
        Some(file) => Err(Error::CheckpointDamaged {
            path: checkpoint.to_path_buf(),
            reason: format!("{file} is missing"),
        }),
    }
}

/// The first problems, and the number of other problems.
fn joined(problems: impl Iterator<Item = String>) -> Option<String> {
    let mut problems: Vec<String> = problems.collect();
    let more = problems.len().saturating_sub(NAMED);
    problems.truncate(NAMED);
    if more > 0 {
        problems.push(format!("and {more} more"));
    }
    (!problems.is_empty()).then(|| problems.join("; "))
}

/// Steps of a run in total; `None` for a number of epochs before the first checkpoint.
fn total_steps(config: &Config, state: Option<&State>) -> Option<u64> {
    let of_epoch = match config.train.epochs {
        None => 1,
        Some(_) => state?.steps_per_epoch?,
    };
    Some(config.length(of_epoch).max_steps)
}

fn ended(state: &State, config: &Config) -> RunStatus {
    let patience = config.train.patience;
    if total_steps(config, Some(state)).is_some_and(|all| state.step >= all) {
        RunStatus::Finished
    } else if patience > 0 && state.progress.validations_since_best >= patience {
        RunStatus::StoppedEarly
    } else {
        RunStatus::Stopped
    }
}

/// The step of the last complete line of the metrics.
fn last_step(path: &Path) -> Option<u64> {
    // Opening a pipe would wait.
    let length = regular(path).ok()?;
    let mut file = File::open(path).ok()?;
    let start = SeekFrom::Start(length.saturating_sub(TAIL));
    file.seek(start).ok()?;
    let mut tail = Vec::new();
    file.take(TAIL).read_to_end(&mut tail).ok()?;
    let tail = String::from_utf8_lossy(&tail);
    let complete = &tail[..tail.rfind('\n')?];
    let line: serde_json::Value = serde_json::from_str(complete.lines().last()?).ok()?;
    line.get("step")?.as_u64()
}

/// Bytes of all files below a folder, without links.
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

/// True for a folder with files of a training run, or with only a config.
pub fn is_run(folder: &Path) -> bool {
    let written = ["checkpoints", "metrics.jsonl", "lock"];
    written.iter().any(|name| folder.join(name).exists()) || has_only_a_config(folder)
}

/// A folder with other files may belong to another program.
fn has_only_a_config(folder: &Path) -> bool {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names: Vec<OsString> = entries.map(|entry| entry.file_name()).collect();
    let beside = ["config.toml", REPORTS, "report.html", SAMPLES, PREVIEWS];
    names.iter().any(|name| name == "config.toml")
        && names.iter().all(|name| {
            let name = name.to_string_lossy();
            beside.contains(&&*name) || name.starts_with('.')
        })
}

/// The name of a folder, also of a path such as `.`.
pub fn folder_name(folder: &Path) -> String {
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.into());
    let name = folder.file_name().unwrap_or(folder.as_os_str());
    name.to_string_lossy().into_owned()
}

/// The `names` of the runs in `folders` or, if two are equal, the folders.
pub fn labels(names: Vec<String>, folders: &[PathBuf]) -> Vec<String> {
    let distinct: HashSet<&String> = names.iter().collect();
    match distinct.len() == names.len() {
        true => names,
        false => folders
            .iter()
            .map(|path| path.display().to_string())
            .collect(),
    }
}

/// The runs in a folder and below by path, including the folder itself and stages.
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
    use kinegrad_systems::BUILT_IN;

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
        for file in ["lost/config.toml", "other/config.toml", "other/main.rs"] {
            let file = root.path().join(file);
            fs::create_dir_all(file.parent().expect("a folder")).expect("folders");
            fs::write(file, "= none").expect("written");
        }
        let found = find(root.path());
        let names: Vec<_> = found
            .iter()
            .map(|path| path.strip_prefix(root.path()).expect("below").to_path_buf())
            .collect();
        let expected = ["lost", "more/deep/two", "one", "one/base"];
        assert_eq!(names, expected.map(PathBuf::from));
        assert_eq!(find(&root.path().join("one/base")).len(), 1);
    }

    #[test]
    fn a_run_without_checkpoints_is_not_started_and_a_bad_one_is_damaged() {
        let root = tempfile::tempdir().expect("a folder");
        let lock = root.path().join("lock");
        fs::write(&lock, "").expect("a lock");
        let status = || Run::read(BUILT_IN, root.path()).status;
        assert_eq!(status(), RunStatus::NotStarted);
        let checkpoint = root.path().join("checkpoints/step-00000004");
        fs::create_dir_all(checkpoint).expect("folders");
        assert_eq!(status(), RunStatus::Damaged);
        let locked = File::open(&lock).expect("the lock");
        locked.try_lock().expect("locked");
        assert_eq!(status(), RunStatus::Training);
    }

    #[test]
    fn each_damaged_checkpoint_is_named_and_the_steps_are_not_known() {
        let root = tempfile::tempdir().expect("a folder");
        for step in 1..=6 {
            let checkpoint = format!("checkpoints/step-0000000{step}");
            fs::create_dir_all(root.path().join(checkpoint)).expect("folders");
        }
        let run = Run::read(BUILT_IN, root.path());
        let problem = run.problem.as_deref().expect("a problem");
        for step in 3..=6 {
            assert!(
                problem.contains(&format!("step-0000000{step}")),
                "{problem}"
            );
        }
        assert!(problem.ends_with("; and 2 more"), "{problem}");
        assert_eq!(
            (run.step, run.steps(|step| step.to_string())),
            (None, "-".to_string())
        );
    }

    #[test]
    fn a_config_that_cannot_be_read_is_a_damaged_run() {
        let root = tempfile::tempdir().expect("a folder");
        fs::write(root.path().join("config.toml"), "= none").expect("written");
        assert!(is_run(root.path()));
        let run = Run::read(BUILT_IN, root.path());
        assert_eq!(run.status, RunStatus::Damaged);
        assert!(run.problem.expect("a problem").contains("config.toml"));
    }

    #[test]
    fn the_last_step_is_that_of_the_last_complete_line() {
        let root = tempfile::tempdir().expect("a folder");
        let path = root.path().join("metrics.jsonl");
        assert_eq!(last_step(&path), None);
        let long = "x".repeat(2 * TAIL as usize);
        let text = format!("{{\"step\":1,\"a\":\"{long}\"}}\n{{\"step\":27,\"loss\":0.5}}\n{{\"st");
        fs::write(&path, text).expect("written");
        assert_eq!(last_step(&path), Some(27));
    }
}
