//! Autoregressive motion: a history encoder and flow matching of the next pose (docs/sources.md,
//! section 5).
//!
//! Recipe `flow` trains both networks on windows of clips. [`FlowGenerator`] continues a history,
//! with texts that may change.

mod config;
mod evaluate;
mod generate;
mod load;
pub mod network;
pub mod recipe;
mod report;
mod sample;
mod train;
mod windows;

use burn::tensor::Device;
use kinegrad_motion::{JointPositions, Representation, Statistics};
use kinegrad_settings::Key;
use toml::Table;

pub use config::{FlowNetwork, FlowTables, PoseConfig, RolloutEvaluationConfig};
pub use generate::FlowGenerator;
pub use windows::{HISTORY, PLACE};

use report::RolloutReport;
use windows::PoseSpace;

use kinegrad_train::checkpoint::State;
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};
use kinegrad_train::{Error, Observer, ParameterCount, RecipeInfo, System, TrainedModel};

const RECIPE: &str = "flow";

const RECIPES: [RecipeInfo; 1] = [RecipeInfo {
    name: RECIPE,
    groups: &["flow"],
}];

/// The system.
pub struct Flow;

impl System for Flow {
    fn name(&self) -> &'static str {
        "flow"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &RECIPES
    }

    fn defaults(&self, _: &RecipeInfo, _: &Table) -> Table {
        config::DEFAULTS.parse().expect("text of a program")
    }

    fn keys(&self) -> Vec<Key> {
        FlowTables::keys()
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(FlowTables::read(tables, place)?))
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config).map(|()| Vec::new())
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        Ok(ParameterCount::trained(&load::model(
            config,
            &Device::flex(),
        )?))
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        load::footprint(config)
    }

    fn accepts(&self, _: &str) -> &'static [&'static str] {
        &[
            "history",
            "item",
            "held_out",
            "text",
            "text_embedding",
            "prompts",
        ]
    }

    fn sampler<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Box<dyn Sampler + 'a>, Error> {
        Ok(Box::new(sample::Rollouts::new(trained, request, sink)?))
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

/// A run's statistics of features and poses.
fn statistics_in(state: &State) -> Result<[Statistics; 2], Error> {
    let features = state.clip_statistics()?.clone();
    let skeleton = state.config.data.humanml3d.skeleton();
    match &state.network_statistics {
        Some(target) if target.channels() == 3 * skeleton.joints() => {
            Ok([features, target.clone()])
        }
        _ => Err(Error::OtherRepresentation {
            recipe: state.config.train.recipe.clone(),
            expected: JointPositions { skeleton }.name(),
        }),
    }
}
