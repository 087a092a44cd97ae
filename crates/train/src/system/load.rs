//! Reading configs and trained models with a list of systems.

use std::path::Path;

use kinegrad_settings::{Document, must_be_finite, must_be_tables, not_among};
use toml::{Table, Value};

use super::{System, Systems};
use kinegrad_data::file::read_text;

use crate::checkpoint::{SavedCheckpoint, Weights};
use crate::config::{
    self, Config, ConfigError, EnvironmentSetting, Place, TrainConfig, alternative, apply,
    difference, give_way, lay_over,
};
use crate::device::open_for;
use crate::error::Error;
use crate::trained_model::TrainedModel;

impl Systems<'_> {
    /// Reads the config at `path` and applies `overrides` of the form `a.b=value` in order.
    ///
    /// # Errors
    /// Names the file and line, or the override, with the fault.
    pub fn load(self, path: &Path, overrides: &[String]) -> Result<Config, ConfigError> {
        self.parse(&read(path)?, &path.display().to_string(), overrides)
    }

    /// [`load`](Self::load) with defaults from `beneath`.
    pub(crate) fn load_over(
        self,
        path: &Path,
        overrides: &[String],
        beneath: &Table,
    ) -> Result<Config, ConfigError> {
        // Errors of the file itself name the file's lines.
        self.load(path, overrides)?;
        let text = read(path)?;
        let mut table = beneath.clone();
        let file: Table = text.parse().expect("text that was just parsed");
        give_way(&mut table, &file);
        lay_over(&mut table, file);
        for argument in overrides {
            apply(&mut table, argument)?;
        }
        self.complete(&table, &|_| path.display().to_string())
    }

    /// The settings of the `environment` that `config` uses.
    pub(crate) fn used(
        self,
        environment: &[EnvironmentSetting],
        config: &Config,
    ) -> Vec<EnvironmentSetting> {
        let is_used = |setting: &&EnvironmentSetting| match setting.key {
            "run.device" => true,
            "data.source" => config.data.kind.has_source(),
            _ => {
                let mut table = Table::try_from(config).expect(config::PLAIN);
                let changed = apply(&mut table, &setting.argument());
                let changed = changed.and_then(|()| self.read(&table, &|_| String::new()));
                changed.is_ok_and(|changed| {
                    let system = self.of(&changed);
                    system.is_ok_and(|(system, _)| system.must_use(&changed).is_ok())
                })
            }
        };
        environment.iter().filter(is_used).cloned().collect()
    }

    /// [`load`](Self::load) from text; errors name `origin` instead of a file.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn parse(
        self,
        text: &str,
        origin: &str,
        overrides: &[String],
    ) -> Result<Config, ConfigError> {
        let document = Document::parse(text, origin)?;
        let mut config = self.complete(&document.table, &|key| document.place(key))?;
        if !overrides.is_empty() {
            let mut table = document.table;
            config = self.overridden(&mut table, overrides)?;
        }
        Ok(config)
    }

    /// The config of `table` with `overrides`; errors name the override.
    fn overridden(self, table: &mut Table, overrides: &[String]) -> Result<Config, ConfigError> {
        let before = table.clone();
        let place = |argument: &str| format!("option `set {argument}`");
        must_set_one(overrides)?;
        for argument in overrides {
            apply(table, argument)?;
        }
        let last = overrides.last().map_or("", String::as_str);
        self.complete(table, &|_| place(last)).map_err(|error| {
            // The override without which the other overrides are valid.
            let is_blamed = |left_out: &usize| {
                let mut table = before.clone();
                let others = overrides.iter().enumerate();
                let mut others = others.filter(|(index, _)| index != left_out);
                others.all(|(_, argument)| apply(&mut table, argument).is_ok())
                    && self.complete(&table, &|_| String::new()).is_ok()
            };
            let blamed = (0..overrides.len()).find(is_blamed);
            let read = |index: usize| self.complete(table, &|_| place(&overrides[index]));
            blamed.and_then(|index| read(index).err()).unwrap_or(error)
        })
    }

    /// A trained run's config with `overrides` of its sampling and evaluation settings.
    pub(crate) fn override_trained(
        self,
        config: &Config,
        overrides: &[String],
    ) -> Result<Config, ConfigError> {
        let named = self.of_recipe(&config.train.recipe);
        let own = named.map_or(&[][..], |(system, _)| system.tables_of_sampling());
        let tables: Vec<&str> = ["sampling", "evaluation"]
            .iter()
            .chain(own)
            .copied()
            .collect();
        for argument in overrides {
            let key = argument.trim_start();
            let named = key.split_once('.').map(|(table, _)| table);
            if !named.is_some_and(|table| tables.contains(&table)) {
                return Err(ConfigError::Trained {
                    hint: self.of_trained(config, key, &tables),
                    argument: argument.clone(),
                    tables: listed(&tables),
                });
            }
        }
        match overrides.is_empty() {
            true => Ok(config.clone()),
            false => {
                let mut table = Table::try_from(config).expect(config::PLAIN);
                forget_sampler(&mut table, overrides);
                self.overridden(&mut table, overrides)
            }
        }
    }

    /// The hint for an override that trained models do not allow.
    fn of_trained(self, config: &Config, argument: &str, tables: &[&str]) -> String {
        let key = argument.split('=').next().unwrap_or_default().trim();
        let meant = self.suggestion(key, &config.train.recipe);
        let is_named = |hint: &String, table: &str| hint.contains(&format!("{table}."));
        let meant = meant.filter(|hint| tables.iter().any(|table| is_named(hint, table)));
        let example = "for example option `set sampling.sampler.num_inference_steps=50`; other settings are \
                       for `kinegrad train`";
        meant.unwrap_or_else(|| example.into())
    }

    /// The config of `given` with the defaults of its recipe.
    fn complete(self, given: &Table, place: Place<'_>) -> Result<Config, ConfigError> {
        let read = self.read(given, place);
        read.map_err(|error| self.guided(error, given))
    }

    /// [`complete`](Self::complete) without hints in errors.
    pub(super) fn read(self, given: &Table, place: Place<'_>) -> Result<Config, ConfigError> {
        must_be_finite(given, place)?;
        config::must_have_one(given, place)?;
        let named = given.get("train").and_then(|train| train.get("recipe"));
        let default = TrainConfig::default().recipe;
        // Values of other types are rejected below.
        let name = named.and_then(Value::as_str).unwrap_or(&default);
        let (system, recipe) = self.of_recipe(name).ok_or_else(|| {
            let names: Vec<&str> = self.recipes().map(|recipe| recipe.name).collect();
            let key = "train.recipe";
            ConfigError::from(not_among(place(key), key, &format!("\"{name}\""), &names))
        })?;
        let mut table = system.defaults(recipe, given);
        give_way(&mut table, given);
        lay_over(&mut table, given.clone());
        let config: Config = config::from_table(&table, place)?;
        let system = system.complete(&config.system.to_table(), place)?;
        let mut config = Config { system, ..config };
        config.complete_length();
        must_be_tables(given, &config, place)?;
        Ok(config)
    }

    /// Rejects invalid values and returns warnings.
    ///
    /// # Errors
    /// Names the first invalid key, its value, the allowed values and a remedy.
    pub fn validate(self, config: &Config) -> Result<Vec<String>, Error> {
        let (system, recipe) = self.of(config)?;
        config.data.validate()?;
        config::validate(config, recipe)?;
        let mut warnings = system.validate(config)?;
        if let Some(max_steps) = config.train.max_steps {
            warnings.extend(longer_warmup(config, max_steps));
        }
        Ok(warnings)
    }

    /// The trained model of the checkpoint `saved`, with `overrides` of sampling and evaluation
    /// settings. Without `device`, the run's device is used.
    ///
    /// # Errors
    /// If an override is invalid, or the device is not available.
    pub fn trained(
        self,
        saved: SavedCheckpoint,
        overrides: &[String],
        weights: Weights,
        device: Option<&str>,
    ) -> Result<TrainedModel, Error> {
        self.trained_on_rank(saved, overrides, weights, device, 0)
    }

    /// [`trained`](Self::trained) for process `local` of a machine: see [`open_for`].
    ///
    /// # Errors
    /// As [`trained`](Self::trained).
    pub fn trained_on_rank(
        self,
        mut saved: SavedCheckpoint,
        overrides: &[String],
        weights: Weights,
        device: Option<&str>,
        local: usize,
    ) -> Result<TrainedModel, Error> {
        let own = self.completed(&saved.state.config)?;
        let config = self.override_trained(&own, overrides)?;
        let (system, _) = self.of(&config)?;
        system.validate(&config)?;
        let (device, name) = open_for(device.unwrap_or(&config.run.device), local)?;
        let (path, step) = (saved.path.display(), saved.state.step);
        log::debug!("checkpoint {path}, step {step}");
        log::debug!("device {name}; {}", crate::device::kernels());
        let overridden = difference(&own, &config).into_iter();
        let overridden = overridden.map(|each| (each.key, each.right));
        saved.state.config = config;
        Ok(TrainedModel {
            overridden: overridden.collect(),
            saved,
            weights,
            device,
            on_host: crate::device::is_host(&name),
        })
    }
}

impl dyn System + '_ {
    /// The checkpoint with the tables of this system deserialized.
    ///
    /// # Errors
    /// If the run is of another system, or its config cannot be read by this version.
    pub fn read_tables(&self, mut saved: SavedCheckpoint) -> Result<SavedCheckpoint, Error> {
        let config = &mut saved.state.config;
        let name = &config.train.recipe;
        let recipes = self.recipes().iter();
        if !recipes.clone().any(|recipe| recipe.name == name) {
            let known: Vec<&str> = recipes.map(|recipe| recipe.name).collect();
            return Err(Error::OtherRecipe {
                recipe: name.clone(),
                known: known.join(", "),
            });
        }
        let tables = config.system.to_table();
        config.system = self.complete(&tables, &|_| "the saved config".into())?;
        Ok(saved)
    }
}

/// A warning if the warm-up is longer than a run of `max_steps`.
pub(crate) fn longer_warmup(config: &Config, max_steps: u64) -> Option<String> {
    let warmup = config.optim.warmup_steps;
    (warmup > max_steps).then(|| {
        let key = match config.train.epochs {
            None => "`train.max_steps`".to_owned(),
            Some(epochs) => format!("the steps of `train.epochs = {epochs}`"),
        };
        format!(
            "`optim.warmup_steps` ({warmup}) is longer than {key} ({max_steps}): the learning rate \
             never reaches `optim.learning_rate`"
        )
    })
}

/// Rejects overrides of both a number of steps and of epochs.
fn must_set_one(overrides: &[String]) -> Result<(), ConfigError> {
    let keys = overrides.iter().filter_map(|set| set.split_once('='));
    let keys: Vec<&str> = keys.map(|(key, _)| key.trim()).collect();
    for key in &keys {
        if let Some(other) = alternative(key)
            && keys.contains(&other.as_str())
        {
            let place = format!("option `set {key}`");
            return Err(config::both(place, (*key).into(), &other));
        }
    }
    Ok(())
}

/// The names of tables as a list: "`a`, `b` and `c`".
fn listed(tables: &[&str]) -> String {
    let quoted: Vec<String> = tables.iter().map(|table| format!("`{table}`")).collect();
    let (last, others) = quoted.split_last().expect("a table");
    format!("{} and {last}", others.join(", "))
}

/// Keys of `sampling.sampler` that belong to some kinds only.
const OF_SAMPLER_KINDS: [&str; 7] = [
    "eta",
    "final_alpha",
    "recompute_epsilon",
    "variance_type",
    "tolerance",
    "timestep_spacing",
    "guidance_until",
];

/// Removes keys of the run's kind of sampler if `overrides` select a kind.
fn forget_sampler(table: &mut Table, overrides: &[String]) {
    let mut keys = overrides
        .iter()
        .filter_map(|argument| argument.split('=').next());
    if !keys.any(|key| key.trim() == "sampling.sampler.kind") {
        return;
    }
    let sampling = table.get_mut("sampling").and_then(Value::as_table_mut);
    let sampler = sampling.and_then(|sampling| sampling.get_mut("sampler")?.as_table_mut());
    if let Some(sampler) = sampler {
        sampler.retain(|key, _| !OF_SAMPLER_KINDS.contains(&key));
    }
}

/// The text of the config at `path`.
pub(crate) fn read(path: &Path) -> Result<String, ConfigError> {
    log::debug!("reading {}", path.display());
    read_text(path).map_err(|source| ConfigError::Read {
        path: path.to_path_buf(),
        source,
    })
}
