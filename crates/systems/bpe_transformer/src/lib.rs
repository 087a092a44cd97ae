//! Motion composed of several texts: a transformer with blended positional encodings
//! (docs/sources.md, section 6).
//!
//! Recipe `bpe_motion` trains the network on clips with one text each, half in absolute and half in
//! relative mode. With `model.path`, the network is also conditioned on the clips' root
//! trajectories. Recipe `path_adapter` adds path conditioning to a frozen network. [`Composer`]
//! samples motion of any length from a sequence of texts.

mod config;
mod evaluate;
mod generate;
mod import;
mod load;
pub mod network;
mod path;
mod path_evaluation;
mod recipe;
mod report;
mod sample;
mod train;

use kinegrad_settings::Key;
use toml::Table;

pub use config::{
    BpeInitConfig, BpeNetwork, BpeTables, ComposeEvaluationConfig, PathAdapterConfig,
    PositionsConfig,
};
pub use generate::Composer;
pub use path::{OverrideTarget, PathConfig, PathMethod};

use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::import::{ImportRequest, Imported};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};
use kinegrad_train::start;
use kinegrad_train::{Error, Observer, ParameterCount, RecipeInfo, System, TrainedModel};

const RECIPE: &str = "bpe_motion";

/// The recipe that adds path conditioning to a trained network.
const ADAPTER: &str = "path_adapter";

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

/// Tables that the initial checkpoint of a run determines.
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
        config::validate(config).map(|()| Vec::new())
    }

    fn inherited(&self, config: &Config, saved: Option<&Config>) -> Result<Option<Table>, Error> {
        let own: &BpeTables = config.own();
        let (init, tokens) = (&own.init.diffusion, own.model.network.sizes().path_tokens);
        let tables = start::inherited(saved, init, &INHERITED, self)?;
        Ok(
            tables.map(|tables| match config::is_path_conditioned(config) {
                true => config::with_paths(tables, tokens),
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

    fn accepts(&self, _: &str) -> &'static [&'static str] {
        &[
            "item",
            "held_out",
            "text",
            "text_embedding",
            "prompts",
            "path",
        ]
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
