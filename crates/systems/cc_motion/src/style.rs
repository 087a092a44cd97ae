//! The style of phrases: labels of a run, style conditions of batches and of samples.

use std::collections::BTreeSet;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{Dataset, LABEL, PhraseItem, STYLE, StyleConditions, is_label};
use kinegrad_kernels::Lengths;
use kinegrad_motion::Statistics;
use kinegrad_settings::{Refused, require};
use kinegrad_train::config::Config;
use kinegrad_train::denoising::Conditions;
use kinegrad_train::sampling::Style;
use kinegrad_train::{Error, Observer};

use super::load::unet1d;
use super::{CcMotionConfig, CcMotionNetwork};
use crate::network::{AudioCondition, StyleCondition, StyleConditioning};

/// `config` with the labels of the training phrases, if the network has labels and the config
/// states no labels. Reports phrases without a known label.
///
/// # Errors
/// If no labels exist, or a training phrase has an invalid or unknown label.
pub(super) fn with_labels(
    config: Config,
    dataset: &Dataset<PhraseItem>,
    observer: &mut dyn Observer,
) -> Result<Config, Error> {
    let mut own = config.own::<CcMotionConfig>().clone();
    let CcMotionNetwork::Unet1d(unet) = &mut own.model.network;
    if !unet.style.has_label() {
        return Ok(config);
    }
    let found = dataset.train.labels();
    let phrase_of = |label: &str| {
        let mut positions = 0..dataset.train.len();
        let position = positions.find(|&p| dataset.train.label(p) == Some(label));
        position.map_or("", |position| dataset.train.id(position))
    };
    if let Some(odd) = found.iter().find(|label| !is_label(label)) {
        return Err(Error::usage(
            format!("phrase `{}` has the label `{odd}`", phrase_of(odd)),
            "labels are words that are no numbers and have no comma; `data.labels` sets others",
        ));
    }
    if unet.style_labels.is_empty() {
        require(
            !found.is_empty(),
            "model.style",
            "a label, and no training phrase has one",
            "\"none\" or \"numbers\" for a dataset without labels",
        )
        .hint("give labels to ids: `data.labels = { \"W_*\" = \"waltz\" }`")?;
        unet.style_labels = found.iter().map(|&label| label.to_owned()).collect();
    }
    let known: BTreeSet<&str> = unet.style_labels.iter().map(String::as_str).collect();
    if let Some(unknown) = found.difference(&known).next() {
        return Err(Error::usage(
            format!(
                "phrase `{}` has the label `{unknown}`, which the network does not know",
                phrase_of(unknown)
            ),
            format!(
                "it knows {}; `data.labels` gives phrases other labels, or none",
                listed(&unet.style_labels)
            ),
        ));
    }
    if let Some(unknown) = dataset.validation.labels().difference(&known).next() {
        observer.warning(&format!(
            "held-out phrases have the label `{unknown}`, which no training phrase has: to the \
             network they have none"
        ));
    }
    let all = dataset.train.len();
    let without = (0..all)
        .filter(|&p| dataset.train.label(p).is_none())
        .count();
    if without > 0 {
        observer.note(&format!(
            "{without} of {all} training phrases have no label: they train the null label"
        ));
    }
    Ok(config.with_own(own))
}

fn listed(labels: &[String]) -> String {
    let quoted = labels.iter().map(|label| format!("`{label}`"));
    quoted.collect::<Vec<_>>().join(", ")
}

/// The style conditions of a config's samples; `statistics` are of the 25 stored channels.
pub(super) fn conditions(config: &Config, statistics: &Statistics) -> StyleConditions {
    let unet = unet1d(config);
    let mut conditions = StyleConditions::default();
    if unet.style.has_numbers() {
        conditions = conditions.with_numbers(statistics);
    }
    if unet.style.has_label() {
        conditions = conditions.with_labels(unet.style_labels.clone());
    }
    conditions
}

/// The denoiser's condition for a batch.
pub(super) fn condition(cond: &Conditions, lengths: Option<Lengths>) -> AudioCondition {
    let of = |name| Some(cond.find(name)?.clone().squeeze_dim::<2>(2));
    let style = StyleCondition {
        numbers: of(STYLE),
        label: of(LABEL),
    };
    let is_conditioned = style.numbers.is_some() || style.label.is_some();
    AudioCondition {
        lengths,
        style: is_conditioned.then_some(style),
        ..cond.get(kinegrad_data::AUDIO).clone().into()
    }
}

/// The style condition of one sample for the network of a config; `statistics` are of the 25 stored
/// channels.
///
/// # Errors
/// As [`must_know`].
pub(super) fn of_sample(
    style: &Style,
    config: &Config,
    statistics: &Statistics,
    device: &Device,
) -> Result<StyleCondition, Error> {
    must_know(style, config)?;
    let conditions = conditions(config, statistics);
    let (numbers, label) = match style {
        Style::Numbers(numbers) => (Some(*numbers), None),
        Style::Label(label) => (None, Some(label.as_str())),
    };
    let names = conditions.shapes().into_iter().map(|(name, _)| name);
    let values: Vec<_> = names.zip(conditions.values(numbers, label)).collect();
    let of = |wanted: &str| {
        let (_, values) = values.iter().find(|(name, _)| *name == wanted)?;
        let data = TensorData::new(values.clone(), [1, values.len()]);
        Some(Tensor::from_data(data, device))
    };
    Ok(StyleCondition {
        numbers: of(STYLE),
        label: of(LABEL),
    })
}

/// Rejects a style that a config's network does not support, and an unknown label.
pub(super) fn must_know(style: &Style, config: &Config) -> Result<(), Error> {
    let unet = unet1d(config);
    let (supported, requested) = match style {
        Style::Numbers(_) => (unet.style.has_numbers(), "eight numbers"),
        Style::Label(_) => (unet.style.has_label(), "a label"),
    };
    if !supported {
        let hint = match unet.style {
            StyleConditioning::None => {
                "train with `model.style` = \"numbers\", \"label\" or \"both\"".to_string()
            }
            StyleConditioning::Numbers => "this run takes eight numbers".to_string(),
            _ => format!("this run takes a label: {}", listed(&unet.style_labels)),
        };
        let named = serde_json::to_string(&unet.style).unwrap_or_default();
        let message =
            format!("option `style` is {requested}, and `model.style` of the run is {named}");
        return Err(Error::usage(message, hint));
    }
    match style {
        Style::Label(label) if !unet.style_labels.contains(label) => Err(Error::usage(
            format!("option `style` is `{label}`, a label that the run does not know"),
            format!("it knows {}", listed(&unet.style_labels)),
        )),
        _ => Ok(()),
    }
}
