//! CC-MotionGen: dance phrases conditioned on audio features (docs/sources.md, section 1).
//!
//! Recipe `diffusion` trains the denoiser, `decoder` a decoder on the denoiser's latents, `e2e`
//! both end to end.

mod beat_warnings;
mod config;
pub mod evaluate;
pub mod generate;
mod generator;
mod leaks;
mod lengths;
mod load;
pub mod losses;
mod merge;
pub mod network;
mod path;
mod pretrain;
mod recipe_name;
pub mod recipes;
mod sample;
mod select;
mod start;
mod style;
mod train;
pub mod windowed;

use std::path::{Path, PathBuf};

use kinegrad_motion::{Phrases, Representation};
use kinegrad_settings::Key;
use kinegrad_train::checkpoint::SavedCheckpoint;
use kinegrad_train::config::{Config, ConfigError, OwnTables, Place, SystemTables};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest};
use kinegrad_train::memory::Footprint;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::sampling::{Request, SampleSink, Sampler};
use kinegrad_train::start::tables_of;
use kinegrad_train::{Error, Observer, ParameterCount, RecipeInfo, System, TrainedModel};
use toml::Table;

use recipe_name::{RECIPES, RecipeName};
use start::Starts;

pub use config::{
    CcMotionConfig, CcMotionNetwork, CondSource, EvaluationConfig, InitConfig, LossConfig,
    PretrainConfig, ReconstructionWeighting, RolloutConfig, RolloutMode, RolloutStart,
};
pub use load::Trained;
pub use path::{PhrasePath, PhrasePathConfig, PhrasePathMethod};

/// The system.
pub struct CcMotion;

impl System for CcMotion {
    fn name(&self) -> &'static str {
        "cc_motion"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &RECIPES
    }

    fn representations(&self) -> Vec<Box<dyn Representation>> {
        vec![Box::new(Phrases)]
    }

    fn fps(&self, _: &Config) -> f64 {
        kinegrad_motion::FPS
    }

    fn keys(&self) -> Vec<Key> {
        CcMotionConfig::keys()
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(CcMotionConfig::read(tables, place)?))
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config)?;
        Ok(Vec::new())
    }

    fn inherited(&self, config: &Config, saved: Option<&Config>) -> Result<Option<Table>, Error> {
        if !RecipeName::of(config).trains_through_sampler() {
            return Ok(None);
        }
        // A resumed run does not need its initial checkpoints.
        if let Some(saved) = saved {
            let tables = [start::OF_BASE.as_slice(), &start::OF_DECODER].concat();
            return Ok(Some(tables_of(saved, &tables)));
        }
        let starts = Starts::named(&config.own::<CcMotionConfig>().init)?;
        Ok(starts.map(|starts| starts.tables_for(config)))
    }

    fn must_use(&self, config: &Config) -> Result<(), Error> {
        start::must_use(config)
    }

    fn stages(&self) -> &'static [&'static str] {
        &pretrain::STAGES
    }

    fn moved(&self, saved: Config, given: &Config, folder: &Path) -> Result<Config, Error> {
        pretrain::moved(saved, given, folder)
    }

    fn parameters(&self, config: &Config) -> Result<ParameterCount, Error> {
        load::parameter_count(config)
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        load::footprint(config, config.data.target_frames)
    }

    fn merge(&self, saved: SavedCheckpoint, out: &Path) -> Result<PathBuf, Error> {
        merge::merge(saved, out)
    }

    fn accepts(&self, _: &str) -> &'static [&'static str] {
        sample::ACCEPTS
    }

    fn sampler<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Box<dyn Sampler + 'a>, Error> {
        Ok(Box::new(sample::Phrases::new(trained, request, sink)?))
    }

    fn accepts_in_evaluation(&self) -> &'static [&'static str] {
        &["audio_ablation", "songs", "num_samples", "num_frames"]
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
