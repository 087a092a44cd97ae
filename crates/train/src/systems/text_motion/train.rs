//! Training of the encoders.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::{Clip, ClipSamples};

use super::TextMotionTables;
use super::networks::{channels, encoders, word_vectors};
use super::recipe::ContrastiveRecipe;
use crate::config::Config;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own: &TextMotionTables = config.own();
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let words = Arc::new(word_vectors(&own.words)?);
    let data = &setup.config.data;
    let dataset = Dataset::<Clip>::open_among(data, &*observer.reading(), &*setup.together)?;
    setup.check_dataset(&dataset, observer)?;
    let statistics = match &setup.checkpoint {
        Some(checkpoint) => {
            let representation = config.data.humanml3d.representation();
            checkpoint.state.statistics_of(&representation)?.clone()
        }
        None => dataset.statistics_among(&*observer.reading(), &*setup.together)?,
    };
    let model = encoders(&config, words.width(), &setup.device)?;
    let (representation, shared) = (dataset.representation.clone(), Arc::new(statistics.clone()));
    let samples = move |clips, config: &Config| {
        let (data, seed, channels) = (&config.data, config.run.seed, channels(config));
        let (representation, statistics) = (representation.clone(), shared.clone());
        ClipSamples::new(clips, representation, statistics, channels, data, seed)
            .with_words(words.clone())
    };
    let (material, held_out) = Material::new(dataset, statistics, &config, samples)?;
    let held_out = held_out.among(&setup.together);
    let recipe = ContrastiveRecipe::new(own.loss.margin, held_out);
    setup.train(material, recipe, model, observer)
}
