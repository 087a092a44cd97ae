//! Training of the encoders.

use std::sync::Arc;

use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::training;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::{Error, Observer};

use super::TextMotionTables;
use super::load::{channels, encoders, word_vectors};
use super::recipe::ContrastiveRecipe;

pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = context.config.clone();
    let own: &TextMotionTables = config.own();
    let context = context.with_gradients(own.model.activation_checkpointing);
    let words = Arc::new(word_vectors(&own.words)?);
    let dataset = training::open(&context, observer)?;
    let statistics = training::statistics(&context, None, &dataset, observer)?;
    let model = encoders(&config, words.width(), &context.device);
    let (channels, text) = (channels(&config), TextInput::Embedding);
    let samples = training::samples(&dataset, &statistics, channels, text);
    let samples = move |clips, config: &_| samples(clips, config).with_words(words.clone());
    let (training_data, held_out) = context.training_data(dataset, statistics, samples)?;
    let margin = own.loss.margin;
    let recipe = ContrastiveRecipe { margin, held_out };
    context.train(training_data, recipe, model, observer)
}
