//! `kinegrad train`

use std::path::PathBuf;

use clap::Args;
use kinegrad_train::Error;
use kinegrad_train::run::Target;

/// Default config file of `kinegrad train`.
pub const DEFAULT_CONFIG: &str = "kinegrad.toml";

/// Arguments of `kinegrad train`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad init && kinegrad train
  kinegrad train phrases.toml --set data.source=phrases --set train.max_steps=100
  kinegrad train phrases.toml --set data.source=phrases --dry-run
  kinegrad train --resume runs/phrases
  kinegrad train --resume runs/phrases --set train.max_steps=2000")]
pub struct TrainArguments {
    /// Config file [default: kinegrad.toml, which `kinegrad init` writes]
    pub config: Option<PathBuf>,
    /// Override a config key, for example optim.learning_rate=2e-4
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Name of the run [default: `run.name`, else the config file's name]
    #[arg(long)]
    pub name: Option<String>,
    /// Folder that contains the runs [default: KINEGRAD_RUNS_DIR, else runs]
    #[arg(long, value_name = "DIR")]
    pub runs_dir: Option<PathBuf>,
    /// Training device, see `kinegrad devices` [default: KINEGRAD_DEVICE, else `run.device`]
    #[arg(long)]
    pub device: Option<String>,
    /// Resume the run in the folder RUN, or the config file's run, from the latest valid checkpoint
    #[arg(long, value_name = "RUN", num_args = 0..=1)]
    pub resume: Option<Option<PathBuf>>,
    /// Validate everything, time a few steps, and print an estimate of parameters, memory, time and
    /// disk space; writes nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Print the summary as one line of JSON
    #[arg(long)]
    pub json: bool,
}

impl TrainArguments {
    /// The run to train. Rejects options that contradict each other.
    pub fn target(&self) -> Result<Target, Error> {
        match (&self.config, &self.resume) {
            (Some(config), None) => Ok(Target::New(config.clone())),
            (Some(config), Some(None)) => Ok(Target::Resumed(config.clone())),
            // `--resume` before a config file.
            (None, Some(Some(file))) if file.is_file() => Ok(Target::Resumed(file.clone())),
            (None, Some(Some(folder))) => {
                for (option, is_set) in [
                    ("--name", self.name.is_some()),
                    ("--runs-dir", self.runs_dir.is_some()),
                ] {
                    if is_set {
                        return Err(Error::usage(
                            format!("`{option}` with `--resume {}`", folder.display()),
                            "the folder selects the run: leave the option out",
                        ));
                    }
                }
                Ok(Target::Folder(folder.clone()))
            }
            (Some(config), Some(Some(folder))) => {
                let (config, folder) = (config.display(), folder.display());
                Err(Error::usage(
                    format!("`--resume {folder}` together with the config file {config}"),
                    format!(
                        "the run has its own config: `kinegrad train --resume {folder}`; change \
                         it with `--set KEY=VALUE`"
                    ),
                ))
            }
            (None, None) => Ok(Target::New(default_config()?)),
            (None, Some(None)) => default_config().map(Target::Resumed).map_err(|_| {
                Error::usage(
                    "`--resume` without a run",
                    "name its folder: `kinegrad train --resume runs/quickstart`",
                )
            }),
        }
    }
}

/// The default config. Fails if the current folder has no such file.
fn default_config() -> Result<PathBuf, Error> {
    let path = PathBuf::from(DEFAULT_CONFIG);
    match path.exists() {
        true => Ok(path),
        false => Err(Error::usage(
            format!("no config is given, and there is no {DEFAULT_CONFIG} in this folder"),
            "`kinegrad init` writes one; or name another: `kinegrad train CONFIG.toml`",
        )),
    }
}
