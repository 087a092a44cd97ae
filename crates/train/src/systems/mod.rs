//! The systems: each a folder with all that is its own.
//!
//! A [`System`] says its name, its recipes, the tables of its configs, and how to check, train,
//! sample, evaluate and import. Nothing outside of a system's folder knows it by name: entry points
//! take a list of [`Systems`] and look a run's system up by its recipe. [`BUILT_IN`] is the list of
//! those here.

pub mod cc_motion;
pub mod gmd;

use std::path::{Path, PathBuf};

use kinegrad_motion::Representation;
use kinegrad_settings::InvalidSetting;
use toml::Table;

use crate::config::{Config, ConfigError, Place};
use crate::error::Error;
use crate::evaluation::{Evaluate, EvaluationRequest};
use crate::import::{ImportRequest, Imported};
use crate::observer::Observer;
use crate::run::{Outcome, Setup};
use crate::sampling::{Receiver, Remark, Request, Subject};

/// A kind of training of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecipeInfo {
    /// Its name, the value of `train.recipe`; no other system may have one of that name.
    pub name: &'static str,
    /// The groups of parameters it trains, each with a learning rate of its own.
    pub groups: &'static [&'static str],
}

/// A way to generate motion: its configs, networks, trainings and samplers.
pub trait System: Sync {
    /// Its name.
    fn name(&self) -> &'static str;

    /// Its kinds of training.
    fn recipes(&self) -> &'static [RecipeInfo];

    /// What the rows of motion files are that its models are trained on or draw.
    fn representations(&self) -> Vec<Box<dyn Representation>>;

    /// What the recipe says where a config is silent, beneath `given`, the config as written.
    fn defaults(&self, _recipe: &RecipeInfo, _given: &Table) -> Table {
        Table::new()
    }

    /// The system's own tables of a config with every key written out; `place` says where a dotted
    /// key stands.
    ///
    /// # Errors
    /// Names the place of a key that is unknown or of the wrong type.
    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<Table, ConfigError>;

    /// Refuses values that cannot work and returns what is doubtful; what every run has is checked
    /// elsewhere.
    ///
    /// # Errors
    /// Names the first key with a bad value.
    fn validate(&self, config: &Config) -> Result<Vec<String>, Error>;

    /// Tables that stand beneath the config of a run because they follow from what it starts from:
    /// of a run that is resumed, from its `saved` config, and of others from the checkpoints that
    /// `config` names.
    ///
    /// # Errors
    /// If such a checkpoint is not there or is damaged.
    fn inherited(&self, _config: &Config, _saved: Option<&Config>) -> Result<Option<Table>, Error> {
        Ok(None)
    }

    /// Whether a run in `folder` has begun what comes before its own training.
    fn has_begun(&self, _folder: &Path) -> bool {
        false
    }

    /// Number of parameters of the networks of a run of `config`, adapters left out.
    ///
    /// # Errors
    /// If a network cannot be built.
    fn parameter_count(&self, config: &Config) -> Result<usize, Error>;

    /// Names of the networks whose weights it imports.
    fn architectures(&self) -> &'static [&'static str] {
        &[]
    }

    /// Writes weights of another program as the only checkpoint of a run.
    ///
    /// # Errors
    /// If they cannot be read or do not fit; nothing is written then.
    fn import(&self, request: &ImportRequest) -> Result<Imported, Error> {
        Err(Error::usage(
            format!("the system `{}` imports no weights", self.name()),
            format!("`{}` is not among its networks", request.architecture),
        ))
    }

    /// Adds the adapters of the checkpoint in `path` to the weights they sit on, and writes the
    /// result as the only checkpoint of a run in `out`, a new or an empty folder. Returns where it
    /// is.
    ///
    /// # Errors
    /// If the checkpoint is damaged or has no adapters, or `out` cannot be written.
    fn merge(&self, path: &Path, _out: &Path) -> Result<PathBuf, Error> {
        Err(Error::NoAdapters {
            path: path.to_path_buf(),
        })
    }

    /// Draws motion and hands each to `receiver`; what is to be said of all of them is returned.
    ///
    /// # Errors
    /// If a condition is of a kind that the model cannot be told, or cannot be read; or if the
    /// receiver fails.
    fn sample(
        &self,
        subject: &Subject,
        request: &Request,
        receiver: &mut dyn Receiver,
    ) -> Result<Option<Remark>, Error>;

    /// An evaluation of a trained model on held-out motion, whose request has been checked.
    ///
    /// # Errors
    /// If what is asked for does not apply to its models, or nothing is held out.
    fn evaluate<'a>(
        &self,
        subject: &'a Subject,
        request: &EvaluationRequest,
    ) -> Result<Evaluate<'a>, Error>;

    /// Trains to the end, or until stopped, by way of [`Setup::train`].
    ///
    /// # Errors
    /// If the run is refused, before anything is written; or if it fails.
    fn train(&self, setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error>;
}

/// The systems that an entry point knows.
#[derive(Clone, Copy)]
pub struct Systems<'a>(pub &'a [&'a dyn System]);

/// The systems of this crate.
pub const BUILT_IN: Systems<'static> = Systems(&[&cc_motion::CcMotion, &gmd::Gmd]);

impl<'a> Systems<'a> {
    /// The recipes of all systems.
    pub fn recipes(self) -> impl Iterator<Item = &'static RecipeInfo> + use<'a> {
        self.0.iter().flat_map(|system| system.recipes())
    }

    /// What the rows of an array of this `shape` with these values are.
    ///
    /// # Errors
    /// If no system knows; `path` is where they were read.
    pub fn representation_of(
        self,
        path: &Path,
        shape: &[usize],
        values: &[f32],
    ) -> Result<Box<dyn Representation>, Error> {
        let known = || self.0.iter().flat_map(|system| system.representations());
        let found = known().find(|representation| representation.accepts(shape, values));
        found.ok_or_else(|| {
            let named = known().map(|known| format!("{} {}", known.name(), known.shape()));
            let names: Vec<String> = named.collect();
            let path = path.display();
            Error::usage(
                format!("{path}: an array of shape {shape:?} is no motion that is known"),
                format!("known are: {}", names.join("; ")),
            )
        })
    }

    /// The system with a recipe of that name, and the recipe.
    pub fn of_recipe(self, name: &str) -> Option<(&'a dyn System, &'static RecipeInfo)> {
        self.0.iter().find_map(|system| {
            let recipe = system.recipes().iter().find(|recipe| recipe.name == name);
            Some((*system, recipe?))
        })
    }

    /// The system and the recipe of a run.
    ///
    /// # Errors
    /// For a recipe of none of these systems.
    pub fn of(
        self,
        config: &Config,
    ) -> Result<(&'a dyn System, &'static RecipeInfo), InvalidSetting> {
        let name = &config.train.recipe;
        self.of_recipe(name).ok_or_else(|| {
            let known: Vec<&str> = self.recipes().map(|recipe| recipe.name).collect();
            InvalidSetting::new("train.recipe", format!("\"{name}\""), known.join(", "))
                .hint("the run is of another system; a newer kinegrad may know it")
        })
    }

    /// A config that was saved by another version, as this one would save it.
    ///
    /// # Errors
    /// As [`of`](Self::of), and [`ConfigError`] for tables that the system cannot read.
    pub fn completed(self, config: &Config) -> Result<Config, Error> {
        let (system, _) = self.of(config)?;
        Ok(Config {
            system: system.complete(&config.system, &|_| "the saved config".into())?,
            ..config.clone()
        })
    }
}
