//! The files of reports: one for each combination of settings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use kinegrad_data::file::read_text;
use kinegrad_train::checkpoint::Weights;
use kinegrad_train::evaluation::Evaluated;
use kinegrad_train::{Error, TrainedModel};
use serde_json::{Value, json};

use crate::args::EvalArguments;
use crate::folder;

/// Longest stem of a report's files, in bytes.
const LONGEST: usize = 200;

/// Settings that the stems of reports already state.
const IN_STEMS: [&str; 2] = ["evaluation.cond", "trajectory_run"];

/// The settings of an evaluation that differ from the runs' configs, by name.
#[derive(Clone, Debug, Default)]
pub struct Settings(BTreeMap<String, String>);

impl Settings {
    /// The settings of an evaluation of `models`.
    pub fn of(models: &[TrainedModel], arguments: &EvalArguments) -> Self {
        let overridden = models.iter().flat_map(|trained| trained.overridden.clone());
        let mut settings: BTreeMap<String, String> = overridden.collect();
        let mut add = |name: &str, value: Option<String>| {
            settings.extend(value.map(|value| (name.to_owned(), value)));
        };
        let (seed, source) = (arguments.seed, arguments.source.clone());
        add("seed", (seed != 0).then(|| seed.to_string()));
        add("source", source);
        let songs = arguments.songs.as_ref();
        add("songs", songs.map(|songs| songs.display().to_string()));
        let number = |count: Option<usize>| count.map(|count| count.to_string());
        add("num_samples", number(arguments.num_samples));
        add("num_frames", number(arguments.num_frames));
        let trajectory = arguments.trajectory_run.as_ref();
        add(
            "trajectory_run",
            trajectory.map(|run| run.display().to_string()),
        );
        let weights = models
            .iter()
            .any(|trained| trained.weights == Weights::Model);
        add("weights", weights.then(|| "model".to_owned()));
        Self(settings)
    }

    /// With the name of the checkpoint if `run` is one.
    #[must_use]
    pub fn of_checkpoint(mut self, run: &Path) -> Self {
        let parent = run.parent().and_then(Path::file_name);
        let name = run
            .file_name()
            .filter(|_| parent.is_some_and(|name| name == "checkpoints"));
        let name = name.map(|name| name.to_string_lossy().into_owned());
        self.0
            .extend(name.map(|name| ("checkpoint".to_owned(), name)));
        self
    }

    /// With the paths of the `runs`.
    #[must_use]
    pub fn of_runs(mut self, runs: &[PathBuf]) -> Self {
        let runs: Vec<_> = runs.iter().map(|run| run.display().to_string()).collect();
        self.0.insert("runs".to_owned(), runs.join(", "));
        self
    }

    /// `-key=value` for each setting that `IN_STEMS` does not list.
    fn suffix(&self) -> String {
        let named = self
            .0
            .iter()
            .filter(|(key, _)| !IN_STEMS.contains(&key.as_str()));
        let named = named.map(|(key, value)| format!("-{}={}", short(key), plain(value)));
        named.collect()
    }
}

/// A key without its table, such as `seeds` for `evaluation.seeds`.
fn short(key: &str) -> &str {
    let key = key.strip_suffix(".kind").unwrap_or(key);
    let tables = ["evaluation.", "sampling.sampler.", "sampling."];
    let mut inner = tables.iter().filter_map(|table| key.strip_prefix(table));
    inner.next().unwrap_or(key)
}

/// A JSON value as a part of a file name: the last component of a path, and `_` for characters that
/// not every file system takes.
fn plain(value: &str) -> String {
    let value = value.trim_matches(['"', '[', ']', '/']);
    let last = value.rsplit(['/', '\\']).next().unwrap_or(value);
    let last = last.replace(".0,", ",");
    let last = last.trim_end_matches(".0").replace(',', "+");
    let taken = |c: char| c.is_ascii_alphanumeric() || "._+-".contains(c);
    last.chars()
        .map(|c| if taken(c) { c } else { '_' })
        .collect()
}

/// The files of a report.
pub struct Reports {
    folder: PathBuf,
    stem: String,
    /// The settings that the report states.
    pub settings: Settings,
}

impl Reports {
    /// Files in the folder of one run, named by the settings.
    pub fn named(folder: &Path, stem: &str, settings: Settings) -> Self {
        let mut stem = format!("{stem}{}", settings.suffix());
        stem.truncate(LONGEST);
        let folder = folder.to_owned();
        Self {
            folder,
            stem,
            settings,
        }
    }

    /// Files in a folder that the user chose.
    pub fn together(folder: &Path, stem: &str, settings: Settings) -> Self {
        Self {
            folder: folder.to_owned(),
            stem: stem.to_owned(),
            settings,
        }
    }

    fn path(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}.{ending}", self.stem))
    }

    /// Makes the folder.
    ///
    /// # Errors
    /// [`Error::Usage`] for a file of other settings, unless it may be overwritten.
    pub fn make(&self, overwrite: bool) -> Result<(), Error> {
        folder::make(&self.folder)?;
        let path = self.path("json");
        let Ok(text) = read_text(&path) else {
            return Ok(());
        };
        let found: Value = serde_json::from_str(&text).unwrap_or_default();
        if overwrite || found["settings"] == json!(self.settings.0) {
            return Ok(());
        }
        let message = format!("{} is a report of other settings", path.display());
        let hint = "replace it with `--overwrite`, or choose another `--out`";
        Err(Error::usage(message, hint))
    }

    /// Writes the report as JSON and CSV, and returns the names of the files.
    pub fn write(&self, all: &[Evaluated], csv: &str) -> Result<String, Error> {
        let files = [
            ("json", json(all, &self.settings) + "\n"),
            ("csv", csv.to_owned()),
        ];
        for (ending, text) in files {
            let path = self.path(ending);
            kinegrad_output::write(&path, text.as_bytes()).map_err(Error::io("write", &path))?;
        }
        Ok(format!("{}, .csv", self.path("json").display()))
    }
}

/// All numbers as JSON.
pub fn json(all: &[Evaluated], settings: &Settings) -> String {
    let all: Vec<_> = all.iter().map(|each| &each.json).collect();
    let report = json!({ "settings": settings.0, "evaluations": all });
    serde_json::to_string_pretty(&report).expect("plain data")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stems_say_the_settings() {
        let stem = |settings: &[(&str, &str)]| {
            let settings = settings.iter();
            let settings = settings.map(|(key, value)| ((*key).into(), (*value).into()));
            let settings = Settings(settings.collect());
            Reports::named(Path::new("reports"), "eval", settings).stem
        };
        assert_eq!(stem(&[]), "eval");
        for (key, value, expected) in [
            ("evaluation.phrases", "5", "eval-phrases=5"),
            ("sampling.sampler.kind", "\"heun\"", "eval-sampler=heun"),
            (
                "sampling.sampler.guidance_scale",
                "2.0",
                "eval-guidance_scale=2",
            ),
            (
                "evaluation.guidance_scales",
                "[1.0,2.5]",
                "eval-guidance_scales=1+2.5",
            ),
            ("source", "s3://bucket/a b/", "eval-source=a_b"),
            ("evaluation.cond", "\"noise\"", "eval"),
        ] {
            assert_eq!(stem(&[(key, value)]), expected, "{key}");
        }
        let both = [("seed", "1"), ("evaluation.seeds", "4")];
        assert_eq!(stem(&both), "eval-seeds=4-seed=1");
        assert!(stem(&[("source", &"x".repeat(400))]).len() <= LONGEST);
        let run = Path::new("runs/one/checkpoints/step-000100");
        let settings = Settings::default().of_checkpoint(run);
        assert_eq!(settings.suffix(), "-checkpoint=step-000100");
        let settings = Settings::default().of_checkpoint(Path::new("runs/one"));
        assert_eq!(settings.suffix(), "");
    }
}
