//! Training of the encoders.

use std::sync::Arc;

use super::TextMotionTables;
use super::load::{channels, encoders, word_vectors};
use super::recipe::ContrastiveRecipe;
use kinegrad_train::Error;
use kinegrad_train::Observer;
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::training;
use kinegrad_train::run::{Outcome, Setup};

/// Trains according to the setup's config.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own: &TextMotionTables = config.own();
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let words = Arc::new(word_vectors(&own.words)?);
    let dataset = training::open(&setup, observer)?;
    let statistics = training::statistics(&setup, None, &dataset, observer)?;
    let model = encoders(&config, words.width(), &setup.device)?;
    let samples = training::samples(
        &dataset,
        &statistics,
        channels(&config),
        TextInput::Embedding,
    );
    let samples = move |clips, config: &_| samples(clips, config).with_words(words.clone());
    let (material, held_out) = setup.material(dataset, statistics, samples)?;
    let recipe = ContrastiveRecipe::new(own.loss.margin, held_out);
    setup.train(material, recipe, model, observer)
}
