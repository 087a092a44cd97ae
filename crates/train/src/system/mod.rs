//! The interface that systems offer to entry points, and the list of systems.

mod evaluate;
mod guide;
mod keys;
mod load;
mod sample;

pub use keys::{ConfigKey, toml_text};
pub(crate) use load::{longer_warmup, read as read_config};

use std::path::{Path, PathBuf};
use std::rc::Rc;

use burn::tensor::Device;
use kinegrad_motion::Representation;
use kinegrad_settings::{InvalidSetting, Key};
use toml::Table;

use crate::checkpoint::SavedCheckpoint;
use crate::clips::evaluator::{EvaluatorFiles, EvaluatorSource, TextMotionEvaluator};
use crate::config::{Config, ConfigError, OwnTables, Place};
use crate::error::Error;
use crate::evaluation::{Evaluation, EvaluationRequest};
use crate::import::{ImportRequest, Imported};
use crate::memory::Footprint;
use crate::observer::Observer;
use crate::parameter_count::ParameterCount;
use crate::recipe::RecipeInfo;
use crate::run::{Outcome, RunContext};
use crate::sampling::{Request, SampleSink, Sampler};
use crate::trained_model::TrainedModel;

/// A method of generating motion: its config tables, networks, recipes and samplers.
pub trait System: Sync {
    /// Its name.
    fn name(&self) -> &'static str;

    /// Its recipes.
    fn recipes(&self) -> &'static [RecipeInfo];

    /// The motion representations of the system's models, beyond those of other systems.
    fn representations(&self) -> Vec<Box<dyn Representation>> {
        Vec::new()
    }

    /// Frames per second of the training motion of `config`.
    fn fps(&self, config: &Config) -> f64 {
        config.data.humanml3d.skeleton().description().fps
    }

    /// Default values of the recipe for keys that are missing in `given`, the config as written.
    fn defaults(&self, _recipe: &RecipeInfo, _given: &Table) -> Table {
        Table::new()
    }

    /// The keys of the system's own config tables with descriptions, usually
    /// [`SystemTables::keys`](crate::config::SystemTables::keys). Without these keys, errors and
    /// `kinegrad config explain` show no descriptions.
    fn keys(&self) -> Vec<Key> {
        Vec::new()
    }

    /// The system's own config tables with all defaults; `place` locates a dotted key.
    ///
    /// # Errors
    /// For an unknown key or a wrong type; the error names the location.
    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError>;

    /// Validates the system's own tables and returns warnings.
    ///
    /// # Errors
    /// For the first invalid value; the error names the key.
    fn validate(&self, config: &Config) -> Result<Vec<String>, Error>;

    /// The system's own tables, except `evaluation`, that may change after training.
    fn tables_of_sampling(&self) -> &'static [&'static str] {
        &[]
    }

    /// Defaults inherited from the `saved` config of a resumed run, otherwise from the initial
    /// checkpoints of `config`.
    ///
    /// # Errors
    /// If an initial checkpoint is missing or damaged.
    fn inherited(&self, _config: &Config, _saved: Option<&Config>) -> Result<Option<Table>, Error> {
        Ok(None)
    }

    /// Rejects settings that the recipe of a new run does not use.
    ///
    /// # Errors
    /// Names the first unused key.
    fn must_use(&self, _config: &Config) -> Result<(), Error> {
        Ok(())
    }

    /// Names of the runs that a run trains first; each has a subfolder of its name.
    fn stages(&self) -> &'static [&'static str] {
        &[]
    }

    /// The `saved` config of the run in `folder`, with the paths between [stages](Self::stages)
    /// from the `given` config. Saved paths are relative to another working directory.
    ///
    /// # Errors
    /// If the system cannot read its tables.
    fn moved(&self, saved: Config, _given: &Config, _folder: &Path) -> Result<Config, Error> {
        Ok(saved)
    }

    /// The parameters of the networks of `config`, adapters included.
    ///
    /// # Errors
    /// If a network cannot be built.
    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error>;

    /// The estimated training memory of the networks of `config`; by default without activations.
    ///
    /// # Errors
    /// If a network cannot be built.
    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        Ok(Footprint {
            parameters: self.parameters(config)?.all as u64,
            activations: 0,
            passes: 1,
            item: 0,
            shared: 0,
        })
    }

    /// Names of the architectures that [`import`](Self::import) supports.
    fn architectures(&self) -> &'static [&'static str] {
        &[]
    }

    /// Converts weights of another program to a run with one checkpoint.
    ///
    /// # Errors
    /// If the weights cannot be read or do not match.
    fn import(&self, request: &ImportRequest) -> Result<Imported, Error> {
        Err(Error::usage(
            format!("the system `{}` imports no weights", self.name()),
            format!("`{}` is not among its networks", request.architecture),
        ))
    }

    /// Merges the adapters of the checkpoint `saved` into its weights and writes the result to
    /// `out`, a new or empty folder, as a run with one checkpoint. Returns the checkpoint's path.
    ///
    /// # Errors
    /// If the checkpoint is damaged or has no adapters, or `out` cannot be written.
    fn merge(&self, saved: SavedCheckpoint, _out: &Path) -> Result<PathBuf, Error> {
        Err(Error::NoAdapters { path: saved.path })
    }

    /// Names of the conditions that a recipe accepts ([`Condition::name`]), and `postprocess` if
    /// its samples are post-processed; empty for a recipe that does not generate motion.
    ///
    /// [`Condition::name`]: crate::sampling::Condition::name
    fn accepts(&self, _recipe: &str) -> &'static [&'static str] {
        &[]
    }

    /// Resolves a request with accepted conditions: reads the conditions' files and checks that all
    /// conditions fit the model. Notes and warnings go to `sink`.
    ///
    /// # Errors
    /// If a condition cannot be read or does not fit the model.
    ///
    /// # Panics
    /// By default: a recipe that accepts no conditions is not sampled.
    fn sampler<'a>(
        &self,
        _trained: &'a TrainedModel,
        _request: &'a Request,
        _sink: &mut dyn SampleSink,
    ) -> Result<Box<dyn Sampler + 'a>, Error> {
        unreachable!("a recipe that accepts no conditions is not sampled")
    }

    /// The text-motion evaluator for an evaluation of `config`.
    fn evaluator_files<'a>(&self, _config: &'a Config) -> Option<&'a EvaluatorFiles> {
        None
    }

    /// The text-motion evaluator in `source` on `device`; `None` for a system without evaluators.
    ///
    /// # Errors
    /// If a file cannot be read, or its contents do not fit.
    fn text_motion_evaluator(
        &self,
        _source: EvaluatorSource<'_>,
        _device: &Device,
    ) -> Result<Option<Rc<dyn TextMotionEvaluator>>, Error> {
        Ok(None)
    }

    /// Names of the evaluation options that the system's models accept: `audio_ablation`,
    /// `trajectory_run`.
    fn accepts_in_evaluation(&self) -> &'static [&'static str] {
        &[]
    }

    /// Validates the request and prepares the evaluation; called by [`Systems::evaluate`].
    ///
    /// # Errors
    /// If the request does not fit the model, or no motion is held out.
    fn evaluate<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &EvaluationRequest,
    ) -> Result<Evaluation<'a>, Error>;

    /// Trains until the end or until interrupted, with [`RunContext::train`].
    ///
    /// # Errors
    /// If the run is rejected, before files are written, or fails.
    fn train(&self, context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error>;
}

/// The systems that are available to an entry point.
#[derive(Clone, Copy)]
pub struct Systems<'a>(pub &'a [&'a dyn System]);

impl<'a> Systems<'a> {
    /// The recipes of all systems.
    pub fn recipes(self) -> impl Iterator<Item = &'static RecipeInfo> + use<'a> {
        self.0.iter().flat_map(|system| system.recipes())
    }

    /// The representation of an array of this `shape` with these values.
    ///
    /// # Errors
    /// If no system recognizes the array; `path` is the file, for the message.
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
                format!("{path}: an array of shape {shape:?} is not a known motion representation"),
                format!("known representations: {}", names.join("; ")),
            )
        })
    }

    /// The recipe of that name and its system.
    ///
    /// # Panics
    /// Panics if two recipes have that name.
    pub fn of_recipe(self, name: &str) -> Option<(&'a dyn System, &'static RecipeInfo)> {
        let all = self.0.iter().flat_map(|system| {
            let recipes = system.recipes().iter();
            recipes.map(move |recipe| (*system, recipe))
        });
        let mut found = all.filter(|(_, recipe)| recipe.name == name);
        let first = found.next()?;
        if let Some((other, _)) = found.next() {
            let (first, other) = (first.0.name(), other.name());
            panic!("two recipes are called `{name}`: of the systems `{first}` and `{other}`");
        }
        Some(first)
    }

    /// The system and the recipe of a run.
    ///
    /// # Errors
    /// If no system has the recipe.
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

    /// A config that was saved by another version, with the defaults of this version filled in.
    ///
    /// # Errors
    /// As [`of`](Self::of), and [`ConfigError`] for tables that the system cannot read.
    pub fn completed(self, config: &Config) -> Result<Config, Error> {
        let (system, _) = self.of(config)?;
        Ok(Config {
            system: system.complete(&config.system.to_table(), &|_| "the saved config".into())?,
            ..config.clone()
        })
    }
}
