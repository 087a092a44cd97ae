//! Starting and resuming runs: validation before files are written.

use std::path::{Path, PathBuf};
use std::rc::Rc;

use kinegrad_data::file::read_text;
use kinegrad_settings::{Refused, require};
use toml::Table;

use super::context::{Outcome, RunContext};
use super::folder::{
    CONFIG, contains_run, exists_already, lock, must_be_a_folder, must_be_inside, must_be_unused,
    must_have_own_files,
};
use crate::checkpoint::Checkpoints;
use crate::config::{self, Config, EnvironmentSetting, OptimPlace, Origins};
use crate::error::Error;
use crate::memory;
use crate::observer::Observer;
use crate::process_group::ProcessGroup;
use crate::system::{Systems, read_config};

/// The run to train.
#[derive(Clone, Debug)]
pub enum Target {
    /// A new run of a config file.
    New(PathBuf),
    /// Resumes the run of a config file.
    Resumed(PathBuf),
    /// Resumes the run in a folder, with its saved config.
    Folder(PathBuf),
}

/// A request to train.
#[derive(Clone, Debug)]
pub struct TrainRequest {
    /// The run.
    pub target: Target,
    /// `KEY=VALUE` overrides.
    pub overrides: Vec<String>,
    /// Settings of the environment, below the overrides and above the config file. A resumed run
    /// takes those that [may differ](config::may_differ).
    pub environment: Vec<EnvironmentSetting>,
    /// Folder that contains the runs; unused for [`Target::Folder`].
    pub runs_dir: PathBuf,
    /// Validate everything and measure a step, but write nothing: the [`Outcome`] has a plan.
    pub dry_run: bool,
}

/// Trains a run with the system of `systems` that has the config's recipe.
///
/// A resumed run takes its saved config with the overrides. Other values in the config file for
/// keys that [may differ](config::may_differ) are ignored with a warning.
///
/// # Errors
/// If the request is invalid (before anything is written), or the run fails.
pub fn train(
    systems: Systems<'_>,
    request: &TrainRequest,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    train_distributed(systems, request, &ProcessGroup::alone(), observer)
}

/// [`train`] by the processes of `group`. The first process writes the run and has its lock.
///
/// # Errors
/// As [`train`]; ranks that did not fail themselves return [`Error::OtherRank`].
pub fn train_distributed(
    systems: Systems<'_>,
    request: &TrainRequest,
    group: &Rc<ProcessGroup>,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    group.report_failure(launch(systems, request, group, observer))
}

fn launch(
    systems: Systems<'_>,
    request: &TrainRequest,
    group: &Rc<ProcessGroup>,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    let size = group.ranks().size();
    if request.dry_run && size > 1 {
        return Err(Error::usage(
            format!("option `dry_run` with {size} ranks"),
            "plan the run in one process, without the launcher",
        ));
    }
    let dry_run = request.dry_run;
    let with_environment = |config: &Config, resumes: bool| {
        let mut used = systems.used(&request.environment, config);
        used.retain(|setting| !resumes || config::may_differ(setting.key));
        with(&used, &request.overrides)
    };
    let path = match &request.target {
        Target::New(path) | Target::Resumed(path) => path,
        Target::Folder(folder) => {
            let saved = saved_of(systems, folder)?;
            let overrides = with_environment(&saved, true);
            let given = systems.parse(&config::to_toml(&saved), SAVED, &overrides)?;
            let folder = folder.clone();
            return train_in(systems, given, folder, true, dry_run, group, observer);
        }
    };
    let resume = matches!(request.target, Target::Resumed(_));
    // A pipe can be read only once.
    let (text, origin) = (read_config(path)?, path.display().to_string());
    let plain = systems.parse(&text, &origin, &request.overrides)?;
    let overrides = &with_environment(&plain, resume);
    let mut config = systems.parse(&text, &origin, overrides)?;
    if config.run.name.is_empty() {
        let stem = path.file_stem().unwrap_or_default();
        config.run.name = stem.to_string_lossy().into_owned();
    }
    let name = config.run.name.clone();
    let folder = request.runs_dir.join(&name);
    let saved = match resume {
        true => saved_config(systems, &folder)?,
        false => None,
    };
    if let Some(saved) = &saved {
        config::must_have_recipe(saved, &config)?;
    }
    let (system, _) = systems.of(&config)?;
    if let Some(beneath) = system.inherited(&config, saved.as_ref())? {
        config = systems.load_over(path, overrides, &beneath)?;
        config.run.name = name;
    }
    if let Some(saved) = &saved {
        let taken = system.moved(saved.clone(), &config, &folder)?;
        config = resumed(systems, &taken, &config, path, overrides, observer)?;
    }
    train_in(systems, config, folder, resume, dry_run, group, observer)
}

/// The overrides after those of the environment.
fn with(environment: &[EnvironmentSetting], overrides: &[String]) -> Vec<String> {
    let environment = environment.iter().map(EnvironmentSetting::argument);
    environment.chain(overrides.iter().cloned()).collect()
}

/// The config of a resumed run, and warnings for other values in the file.
fn resumed(
    systems: Systems<'_>,
    saved: &Config,
    given: &Config,
    path: &Path,
    overrides: &[String],
    observer: &mut dyn Observer,
) -> Result<Config, Error> {
    let recipe = format!("[train]\nrecipe = \"{}\"", given.train.recipe);
    let defaults = systems.parse(&recipe, "the defaults", &[])?;
    let file = read_text(path).ok().and_then(|text| text.parse().ok());
    let file: Table = file.unwrap_or_default();
    let (table, ignored) = config::resumed(saved, given, &defaults, &file, overrides);
    for config::IgnoredKey { key, saved, given } in ignored {
        let (file, set) = (path.display(), given.trim_matches('"'));
        observer.warning(&format!(
            "`{key}` is {given} in {file} and {saved} in the run's saved config, which counts; \
             option `set {key}={set}` takes the new value"
        ));
    }
    let text = toml::to_string(&table).expect("a config is a table of plain values");
    Ok(systems.parse(&text, SAVED, &[])?)
}

/// The name of the saved config in errors.
const SAVED: &str = "the run's saved config";

/// The config of the run in `folder`, or of its newest good checkpoint.
fn saved_of(systems: Systems<'_>, folder: &Path) -> Result<Config, Error> {
    if let Some(saved) = saved_config(systems, folder)? {
        return Ok(saved);
    }
    let checkpoint = match folder.is_dir() {
        true => Checkpoints::of(folder).newest_good(|_| {})?,
        false => None,
    };
    match checkpoint {
        Some(checkpoint) => systems.completed(&checkpoint.state.config),
        None => Err(Error::RunMissing {
            path: folder.to_path_buf(),
            hint: "give the folder of a run, such as runs/quickstart; a new run takes a config \
                   file: `kinegrad train CONFIG`"
                .into(),
        }),
    }
}

/// Reads a config with the `environment` and the values inherited from its initial checkpoints, and
/// the origins of its values. If a checkpoint is missing, calls `warn` and returns the config without
/// inherited values.
///
/// # Errors
/// If the config cannot be read.
pub fn load_config(
    systems: Systems<'_>,
    path: &Path,
    overrides: &[String],
    environment: &[EnvironmentSetting],
    warn: &mut dyn FnMut(&Error),
) -> Result<(Config, Origins), Error> {
    let (text, origin) = (read_config(path)?, path.display().to_string());
    let plain = systems.parse(&text, &origin, overrides)?;
    let keys = overrides.iter().filter_map(|set| set.split_once('='));
    let mut origins = Origins {
        overrides: keys.map(|(key, _)| key.trim().to_owned()).collect(),
        environment: systems.used(environment, &plain),
        file: text.parse().unwrap_or_default(),
        inherited: Table::new(),
    };
    let overrides = &with(&origins.environment, overrides);
    let config = systems.parse(&text, &origin, overrides)?;
    let (system, _) = systems.of(&config)?;
    let config = match system.inherited(&config, None) {
        Ok(Some(beneath)) => {
            let config = systems.load_over(path, overrides, &beneath)?;
            origins.inherited = beneath;
            config
        }
        Ok(None) => config,
        Err(error) => {
            warn(&error);
            config
        }
    };
    Ok((config, origins))
}

/// The config beside the checkpoints of the run in `folder`, if the file exists.
///
/// # Errors
/// [`Error::Usage`] for a link that leads out of the run, else as [`Systems::load`].
pub fn saved_config(systems: Systems<'_>, folder: &Path) -> Result<Option<Config>, Error> {
    let path = folder.join(CONFIG);
    if !path.exists() {
        return Ok(None);
    }
    must_be_inside(folder, CONFIG)?;
    Ok(Some(systems.load(&path, &[])?))
}

/// Trains the run of a resolved config, in the folder of its name under `runs_dir`. Collective.
///
/// # Errors
/// As [`train_distributed`].
pub fn train_config(
    systems: Systems<'_>,
    config: Config,
    runs_dir: &Path,
    resume: bool,
    group: &Rc<ProcessGroup>,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    let folder = runs_dir.join(&config.run.name);
    train_in(systems, config, folder, resume, false, group, observer)
}

/// Rejects a number of ranks that cannot share the micro-batches of a step.
fn must_share(config: &Config, group: &ProcessGroup) -> Result<(), Error> {
    let steps = config.train.gradient_accumulation_steps;
    let size = group.ranks().size() as u64;
    require(
        steps.is_multiple_of(size),
        "train.gradient_accumulation_steps",
        steps,
        format!("a multiple of {size}, because the ranks share the micro-batches of a step"),
    )
    .hint(
        "a step is the same whatever the number of ranks: set it to a multiple, with fewer \
         `data.batch_size` for the same items per step, or start fewer ranks",
    )?;
    Ok(require(
        size == 1 || config.optim.offload != OptimPlace::Device,
        "optim.offload",
        "\"device\"",
        format!("\"auto\" or \"host\", as {size} ranks add their gradients in main memory"),
    )?)
}

/// Largest batch of samples.
const SAMPLES_AT_ONCE: usize = 32;

fn train_in(
    systems: Systems<'_>,
    config: Config,
    folder: PathBuf,
    resume: bool,
    dry_run: bool,
    group: &Rc<ProcessGroup>,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    for warning in systems.validate(&config)? {
        observer.warning(&warning);
    }
    must_share(&config, group)?;
    let (system, recipe) = systems.of(&config)?;
    let name = config.run.name.clone();
    must_be_a_folder(&folder)?;
    must_have_own_files(&folder, system.stages())?;
    let mut exists = contains_run(&folder)?;
    for stage in system.stages() {
        exists |= contains_run(&folder.join(stage))?;
    }
    match (exists, resume) {
        (true, false) => return Err(exists_already(&name, &folder)),
        (false, true) if !folder.exists() => {
            let hint = "without option `resume` a new run of that name is started".into();
            return Err(Error::RunMissing { path: folder, hint });
        }
        _ => {}
    }
    let locks = exists && !dry_run && group.writes();
    let lock = locks.then(|| lock(&folder)).transpose()?;
    let checkpoint = match resume {
        false => None,
        true => Checkpoints::of(&folder).newest_good(|damaged| {
            observer.warning(&format!("{damaged}; falling back to the one before"));
        })?,
    };
    let saved = match &checkpoint {
        Some(checkpoint) => Some(systems.completed(&checkpoint.state.config)?),
        None if resume => saved_config(systems, &folder)?,
        None => None,
    };
    match saved {
        Some(saved) => config::must_continue(&system.moved(saved, &config, &folder)?, &config)?,
        None => {
            system.must_use(&config)?;
            must_be_unused(&folder)?;
        }
    }

    let local = group.ranks().local().rank;
    let (device, device_name) = crate::device::open_for(&config.run.device, local)?;
    let on_host = crate::device::is_host(&device_name);
    log::debug!("device {device_name}; {}", crate::device::kernels());
    let footprint = system.footprint(&config)?;
    let needed = footprint.of_training(&config, on_host);
    let exchanged = match group.ranks().size() {
        1 => 0,
        _ => footprint.of_exchange(),
    };
    let memory_of_samples = match config.sampling.count_at_end {
        0 => 0,
        count => footprint.of_sampling(count.min(SAMPLES_AT_ONCE), false, on_host),
    };
    let processes = group.ranks().local().size;
    memory::must_fit(
        "training",
        (needed + exchanged).saturating_mul(processes as u64),
        "choose a smaller model (`model.*`), fewer `data.batch_size`, `validation.batch_size`, \
         `data.target_frames` or, with synthetic data, `data.synthetic.phrases`; `kinegrad config \
         show` prints the estimate",
    )?;
    group.done(Ok(()))?;
    let step = checkpoint.as_ref().map(|checkpoint| checkpoint.state.step);
    group.must_compute_alike()?;
    if let Some(warning) = group.shared_card(&device_name)
        && !on_host
    {
        observer.warning(&warning);
    }
    group.must_match(&[
        ("config", &config::to_toml(&config)),
        ("step to continue from", &step.unwrap_or(0).to_string()),
    ])?;
    let context = RunContext {
        dry_run,
        memory: needed,
        memory_of_samples,
        recipe,
        device,
        device_name,
        folder,
        lock,
        checkpoint,
        config,
        group: group.clone(),
    };
    system.train(context, observer)
}
