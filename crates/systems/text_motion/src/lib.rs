//! Text-motion evaluators: encoders of clips and captions whose embeddings are close if the caption
//! describes the clip (docs/sources.md, section 4.12).
//!
//! Recipe `text_motion` trains the encoders on a dataset of clips without a published evaluator.
//! [`TextMotion`] is an evaluator from such a run or from published weights.

mod config;
mod evaluate;
mod evaluator;
mod load;
pub mod network;
mod recipe;
mod train;

use std::rc::Rc;

use burn::tensor::Device;
use kinegrad_settings::Key;
use toml::Table;

pub use config::{TextMotionLossConfig, TextMotionNetwork, TextMotionTables, WordsConfig};
pub use evaluator::TextMotion;

use kinegrad_train::checkpoint::Weights;
use kinegrad_train::clips::evaluator::{EvaluatorSource, TextMotionEvaluator};
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::{Error, Observer, ParameterCount, RecipeInfo, System, TrainedModel};

const RECIPE: &str = "text_motion";

const RECIPES: [RecipeInfo; 1] = [RecipeInfo {
    name: RECIPE,
    groups: &["encoders"],
}];

/// The system.
pub struct TextMotionSystem;

impl System for TextMotionSystem {
    fn name(&self) -> &'static str {
        "text_motion"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &RECIPES
    }

    fn defaults(&self, _: &RecipeInfo, _: &Table) -> Table {
        config::DEFAULTS.parse().expect("text of a program")
    }

    fn keys(&self) -> Vec<Key> {
        TextMotionTables::keys()
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(TextMotionTables::read(tables, place)?))
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config).map(|()| Vec::new())
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        let words = load::word_vectors(&config.own::<TextMotionTables>().words)?;
        let encoders = load::encoders(config, words.width(), &Device::flex());
        Ok(ParameterCount::trained(&encoders))
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        load::footprint(config)
    }

    fn text_motion_evaluator(
        &self,
        source: EvaluatorSource<'_>,
        device: &Device,
    ) -> Result<Option<Rc<dyn TextMotionEvaluator>>, Error> {
        let evaluator = match source {
            EvaluatorSource::Run(saved) => TextMotion::of_run(saved, Weights::Ema, device)?,
            EvaluatorSource::Files(files) => TextMotion::read(files, device)?,
        };
        Ok(Some(Rc::new(evaluator)))
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
