//! Guided Motion Diffusion: clips of joint features conditioned on text, with position control
//! (docs/sources.md, section 4).
//!
//! Recipe `gmd_motion` trains the motion model. Recipe `gmd_trajectory` trains the first stage's
//! model of the root path.

mod config;
mod defaults;
mod evaluate;
mod generate;
mod import;
mod load;
pub mod network;
mod padding;
mod recipe_name;
pub mod recipes;
mod sample;
mod stage;
mod steering;
mod summary;
mod train;

use kinegrad_motion::humanml::{Root, Skeleton};
use kinegrad_motion::{GroundPath, JointFeatures, JointPositions, Representation};
use kinegrad_settings::Key;
use toml::Table;

pub use config::{
    EvaluationSplit, GmdConfig, GmdEvaluationConfig, GmdInitConfig, GmdLossConfig, TrajectoryForm,
};
pub use generate::{ClipGenerator, ClipRequest, GeneratedClip, NoiseKey};
pub use load::{TrainedClips, channels_of, model_in_space, text_denoiser};
pub use stage::{GroundObjective, StageModel, StageSteering};
pub use steering::{Padding, SteeringConfig};

use kinegrad_train::clips::evaluator::EvaluatorFiles;
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::import::{ImportRequest, Imported};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};
use kinegrad_train::start;
use kinegrad_train::{Error, Observer, ParameterCount, RecipeInfo, System, TrainedModel};
use load::INHERITED;
use recipe_name::RECIPES;

/// The system.
pub struct Gmd;

impl System for Gmd {
    fn name(&self) -> &'static str {
        "gmd"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &RECIPES
    }

    fn representations(&self) -> Vec<Box<dyn Representation>> {
        let fps = Skeleton::humanml3d().description().fps;
        let mut all: Vec<Box<dyn Representation>> = vec![Box::new(GroundPath { fps })];
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            for root in [Root::Relative, Root::Absolute] {
                let skeleton = skeleton.clone();
                all.push(Box::new(JointFeatures { skeleton, root }));
            }
            all.push(Box::new(JointPositions { skeleton }));
        }
        all
    }

    fn defaults(&self, recipe: &RecipeInfo, given: &Table) -> Table {
        defaults::of_recipe(recipe, given)
    }

    fn keys(&self) -> Vec<Key> {
        GmdConfig::keys()
    }

    fn tables_of_sampling(&self) -> &'static [&'static str] {
        &["steering"]
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(GmdConfig::read(tables, place)?))
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config)?;
        Ok(config::warnings(config).into_iter().collect())
    }

    fn inherited(&self, config: &Config, saved: Option<&Config>) -> Result<Option<Table>, Error> {
        let init = &config.own::<GmdConfig>().init.diffusion;
        start::inherited(saved, init, &INHERITED, self)
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        load::parameters_in_space(config)
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
        Ok(Box::new(sample::Clips::new(trained, request, sink)?))
    }

    fn evaluator_files<'a>(&self, config: &'a Config) -> Option<&'a EvaluatorFiles> {
        Some(&config.own::<GmdConfig>().evaluation.evaluator)
    }

    fn accepts_in_evaluation(&self) -> &'static [&'static str] {
        &["trajectory_run"]
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
