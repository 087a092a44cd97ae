//! Motion composed of several texts: a transformer with blended positional encodings (docs/sources.md,
//! section 6).
//!
//! Recipe `bpe_motion` trains it on clips with one text each, half in absolute and half in relative
//! mode, and with `model.path` on their root trajectories; recipe `path_adapter` adds path
//! conditioning to a frozen network. [`Composer`] samples motion of any length from a sequence of
//! texts.

mod config;
mod evaluate;
mod generate;
mod import;
mod load;
pub mod network;
mod path;
mod path_condition;
mod path_evaluation;
mod recipe;
mod report;
mod sample;
mod train;

use kinegrad_motion::Representation;
use kinegrad_settings::Key;
use toml::Table;

pub use config::{
    BpeInitConfig, BpeNetwork, BpeTables, ComposeEvaluationConfig, PathAdapterConfig,
    PathTrainingConfig, PositionsConfig,
};
pub use generate::Composer;
pub use path::{OverrideTarget, PathConfig, PathMethod};
pub use path_evaluation::PathFollowingReport;
pub use report::ComposedReport;

use kinegrad_train::Error;
use kinegrad_train::Observer;
use kinegrad_train::ParameterCount;
use kinegrad_train::RecipeInfo;
use kinegrad_train::System;
use kinegrad_train::TrainedModel;
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::import::{ImportRequest, Imported};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};
use kinegrad_train::start::{Start, tables_of};

/// Name of the recipe.
pub(crate) const RECIPE: &str = "bpe_motion";

/// Name of the recipe that teaches a trained network to follow paths.
pub(crate) const ADAPTER: &str = "path_adapter";

const RECIPES: [RecipeInfo; 2] = [
    RecipeInfo {
        name: RECIPE,
        groups: &["transformer"],
    },
    RecipeInfo {
        name: ADAPTER,
        groups: &["transformer"],
    },
];

/// Tables that follow from what a run starts from.
const INHERITED: [&str; 3] = ["model", "text", "diffusion"];

/// The system.
pub struct BpeTransformer;

impl System for BpeTransformer {
    fn name(&self) -> &'static str {
        "bpe_transformer"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &RECIPES
    }

    /// None of its own: it generates clips of joint features, which models of clips do too.
    fn representations(&self) -> Vec<Box<dyn Representation>> {
        Vec::new()
    }

    fn defaults(&self, recipe: &RecipeInfo, _: &Table) -> Table {
        let defaults = match recipe.name {
            ADAPTER => format!("{}{}", config::DEFAULTS, config::ADAPTER_DEFAULTS),
            _ => config::DEFAULTS.to_string(),
        };
        defaults.parse().expect("text of a program")
    }

    fn keys(&self) -> Vec<Key> {
        BpeTables::keys()
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(BpeTables::read(tables, place)?))
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config)?;
        Ok(Vec::new())
    }

    fn inherited(&self, config: &Config, saved: Option<&Config>) -> Result<Option<Table>, Error> {
        let tables = match saved {
            // A resumed run does not need its start any more.
            Some(saved) => Some(tables_of(saved, &INHERITED)),
            None => {
                let init = &config.own::<BpeTables>().init;
                let start = Start::named("init.diffusion", &init.diffusion, self)?;
                start.map(|start| start.tables(&INHERITED))
            }
        };
        Ok(
            tables.map(|tables| match config::is_path_conditioned(config) {
                true => config::with_paths(tables),
                false => tables,
            }),
        )
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        load::parameters(config)
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        load::footprint(config, config.data.target_frames)
    }

    fn architectures(&self) -> &'static [&'static str] {
        &import::ARCHITECTURES
    }

    fn import(&self, request: &ImportRequest) -> Result<Imported, Error> {
        import::import(request)
    }

    fn accepts(&self, recipe: &str) -> &'static [&'static str] {
        sample::accepts(recipe)
    }

    fn sampler<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Box<dyn Sampler + 'a>, Error> {
        Ok(Box::new(sample::Compositions::new(trained, request, sink)?))
    }

    fn evaluate<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &EvaluationRequest,
    ) -> Result<Evaluation<'a>, Error> {
        evaluate::prepare(trained, request)
    }

    fn train(&self, context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
        train::train(context, observer)
    }
}
