//! Motion composed of several texts: a transformer with blended positional encodings (docs/sources.md,
//! section 6).
//!
//! Recipe `bpe_motion` trains it on clips with one text each, in absolute mode as often as in relative
//! mode. [`Composer`] draws motion of any length from texts one after another.

mod config;
mod evaluate;
mod generate;
mod import;
mod networks;
mod path;
mod recipe;
mod report;
mod sample;
mod train;

use kinegrad_motion::Representation;
use kinegrad_settings::Key;
use toml::Table;

pub use config::{BpeNetwork, BpeTables, ComposeEvaluationConfig, PositionsConfig};
pub use generate::{Composer, Line};
pub use path::{Followed, OverrideReading, PathConfig, PathMethod, PathTarget};
pub use report::ComposedReport;

use crate::config::{Config, ConfigError, Place, SystemTables};
use crate::error::Error;
use crate::evaluation::{Evaluate, EvaluationRequest};
use crate::import::{ImportRequest, Imported};
use crate::memory::Footprint;
use crate::observer::Observer;
use crate::recipe::RecipeInfo;
use crate::run::{Outcome, Setup};
use crate::sampling::{Receiver, Remark, Request, Subject};
use crate::system::System;

/// Name of the recipe.
pub(super) const RECIPE: &str = "bpe_motion";

const RECIPES: [RecipeInfo; 1] = [RecipeInfo {
    name: RECIPE,
    groups: &["transformer"],
}];

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

    fn defaults(&self, _: &RecipeInfo, _: &Table) -> Table {
        config::DEFAULTS.parse().expect("text of a program")
    }

    fn keys(&self) -> Vec<Key> {
        BpeTables::keys()
    }

    fn complete(&self, tables: &Table, place: Place<'_>) -> Result<Table, ConfigError> {
        Ok(BpeTables::read(tables, place)?.to_table())
    }

    fn validate(&self, config: &Config) -> Result<Vec<String>, Error> {
        config::validate(config)?;
        Ok(Vec::new())
    }

    fn parameter_count(&self, config: &Config) -> Result<usize, Error> {
        networks::parameter_count(config)
    }

    fn footprint(&self, config: &Config) -> Result<Footprint, Error> {
        networks::footprint(config, config.data.target_frames)
    }

    fn architectures(&self) -> &'static [&'static str] {
        &import::ARCHITECTURES
    }

    fn import(&self, request: &ImportRequest) -> Result<Imported, Error> {
        import::import(request)
    }

    fn sample(
        &self,
        subject: &Subject,
        request: &Request,
        receiver: &mut dyn Receiver,
    ) -> Result<Option<Remark>, Error> {
        sample::sample(subject, request, receiver)
    }

    fn evaluate<'a>(
        &self,
        subject: &'a Subject,
        request: &EvaluationRequest,
    ) -> Result<Evaluate<'a>, Error> {
        evaluate::prepare(subject, request)
    }

    fn train(&self, setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
        train::train(setup, observer)
    }
}
