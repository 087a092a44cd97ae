//! Autoregressive motion: a history encoder and flow matching of the next pose (docs/sources.md,
//! section 5).
//!
//! Recipe `flow` trains them on windows of clips. [`FlowGenerator`] continues a history, with texts
//! that may change.

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
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::{JointPositions, Representation};
use kinegrad_settings::Key;
use toml::Table;

pub use config::{FlowNetwork, FlowTables, PoseConfig, RolloutEvaluationConfig};
pub use generate::FlowGenerator;
pub use report::{RolloutReport, bone_lengths};
pub use windows::{HISTORY, PLACE, PoseSpace, PoseWindows};

use kinegrad_train::Error;
use kinegrad_train::Observer;
use kinegrad_train::ParameterCount;
use kinegrad_train::RecipeInfo;
use kinegrad_train::System;
use kinegrad_train::TrainedModel;
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};

/// Name of the recipe.
pub(crate) const RECIPE: &str = "flow";

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

    /// None of its own: it generates joints, which models of clips do too.
    fn representations(&self) -> Vec<Box<dyn Representation>> {
        Vec::new()
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
        config::validate(config)?;
        Ok(Vec::new())
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        let network = load::model(config, &Device::flex())?;
        Ok(ParameterCount::trained(&network))
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        load::footprint(config)
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

/// The statistics of features and poses of a run.
///
/// # Errors
/// [`Error::OtherRepresentation`] for a run of another system.
fn statistics_in(state: &State) -> Result<train::Both, Error> {
    let humanml3d = &state.config.data.humanml3d;
    let features = state.clip_statistics()?.clone();
    let skeleton: Skeleton = humanml3d.skeleton.skeleton();
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
